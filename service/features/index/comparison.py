"""The comparison of two described submaps by their stored places."""

from __future__ import annotations

import structlog

from revisit.core.config import PipelineConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch
from revisit.core.pair_verdict import InitialPose, PairVerdict, RejectedLoop, RejectionReason
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.features.catalogue.maps import model_for_map
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.ports.blobs import PLACE_BLOB, BlobStore
from revisit.service.ports.recogniser import PlaceRecogniser

log = structlog.get_logger(__name__)


class Comparison:
    """Verifies pairs; a damaged place is a verdict, not an error."""

    def __init__(self, blobs: BlobStore, recogniser: PlaceRecogniser) -> None:
        """`recogniser` is the method; `blobs` hold the places."""
        self._blobs = blobs
        self._recogniser = recogniser

    def verify(
        self,
        query: SubmapRecord | bytes,
        match: RecalledPlace,
        config: PipelineConfig,
        initial: InitialPose | None = None,
    ) -> PairVerdict:
        """The verdict on a query, a described submap or a place, and a recalled place."""
        try:
            asked = query if isinstance(query, bytes) else self._place(query)
            return self._recogniser.verify(asked, self._place(match.submap), match.similarity, config, initial)
        except DataLoss as error:
            pair = [one.key.name for one in (query, match.submap) if isinstance(one, SubmapRecord)]
            log.error("place_lost", submaps=pair, reason=error.reason)
            return RejectedLoop(RejectionReason.PLACE_LOST, message=error.message)

    def _place(self, submap: SubmapRecord) -> bytes:
        return self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))


def require_same_model(record: MapRecord, recogniser: PlaceRecogniser) -> None:
    """Raises DescriptorModelMismatch where a map was described by another model than this worker has."""
    own = model_for_map(record, recogniser)
    if record.model_version not in (None, own):
        raise DescriptorModelMismatch(
            f"map {record.map_id} was described by model {record.model_version}, this worker has {own}"
        )
