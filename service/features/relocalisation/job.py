"""The job that answers a view of a conversation."""

from __future__ import annotations

from functools import partial

from revisit.core.config import PipelineConfig
from revisit.core.errors import DegenerateCloud, EmptyCloud
from revisit.core.relocalisation import RelocalisationAnswer
from revisit.core.relocalisation.conversation import Relocalisation
from revisit.core.relocalisation.looking import answered
from revisit.core.relocalisation.view_window import ViewCloud
from revisit.service.domain.errors import NoAnswer
from revisit.service.domain.records import JobRecord, MapRecord
from revisit.service.features.index.answers import criteria_from_json
from revisit.service.features.index.comparison import Comparison, require_same_model
from revisit.service.features.index.place_memory import PlaceMemory, vector_filter
from revisit.service.features.ingest.clouds import QUERY_NONCE_BYTES, unpack_cloud
from revisit.service.features.relocalisation.rows import MapPositions, StoredPlaces
from revisit.service.features.relocalisation.rules import (
    ViewAnswer,
    answer_to_json,
    state_from_json,
    state_to_json,
    view_from_json,
)
from revisit.service.ports.blobs import QUERY_CLOUD_BLOB
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork


class RelocalisationJob:
    """Answers views of conversations; all calls block."""

    def __init__(self, context: JobContext, memory: PlaceMemory, recogniser: PlaceRecogniser) -> None:
        """`memory` searches this worker's own index."""
        self._context = context
        self._memory = memory
        self._recogniser = recogniser
        self._comparison = Comparison(context.blobs, recogniser)
        self._positions = MapPositions(context.transactions)

    def run(self, lease: Lease) -> None:
        """Answer one view. Raises NoAnswer, NotFound, and the errors of the method."""
        job = lease.job
        map_record, where = self._context.transactions.read(partial(_queried, job=job)).result()
        require_same_model(map_record, self._recogniser)
        config = self._context.policy.for_map(map_record)
        conversation = Relocalisation(config, state_from_json(job.payload["state"]))
        view, travelled_m = self._view(job), float(job.payload["travelled_m"])
        try:
            description = self._recogniser.describe(view.submap, config)
        except (DegenerateCloud, EmptyCloud):
            found = ViewAnswer(conversation.lost(travelled_m), ())
        else:
            found = self._answered(conversation, view, travelled_m, map_record, where, description, config)
        result = {"answer": answer_to_json(found), "state": state_to_json(conversation.state)}
        self._context.complete(lease, result)

    def _answered(
        self,
        conversation: Relocalisation,
        view: ViewCloud,
        travelled_m: float,
        map_record: MapRecord,
        where: VectorFilter,
        description: SubmapDescription,
        config: PipelineConfig,
    ) -> ViewAnswer:
        places = StoredPlaces(map_record, where, description, config, self._memory, self._comparison, self._positions)
        answer: RelocalisationAnswer = answered(conversation, view.T_odom_view, travelled_m, places, config)
        told = tuple(places.told(pose) for pose in answer.poses)
        return ViewAnswer(answer, told, places.on_other_storeys)

    def _view(self, job: JobRecord) -> ViewCloud:
        sha256 = str(job.payload["cloud_sha256"])
        if not self._context.blobs.exists(job.tenant, QUERY_CLOUD_BLOB, sha256):
            raise NoAnswer("nobody waits for this view any more: its cloud is gone")
        blob = self._context.blobs.get(job.tenant, QUERY_CLOUD_BLOB, sha256)
        return view_from_json(job.payload, unpack_cloud(blob[QUERY_NONCE_BYTES:]).points)


def _queried(uow: UnitOfWork, job: JobRecord) -> tuple[MapRecord, VectorFilter]:
    """The map of a view, and the submaps that may be compared. Raises NotFound."""
    map_id, criteria = str(job.payload["map_id"]), criteria_from_json(job.payload["criteria"])
    where = vector_filter(uow, job.tenant, map_id, criteria, None)
    return require_map(uow, job.tenant, map_id), where
