"""The comparison of two described submaps by their stored places."""

from __future__ import annotations

from dataclasses import replace

import structlog

from revisit.core.config import PipelineConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import PairVerdict, RejectedLoop, RejectionReason
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.features.catalogue.maps import model_for_map
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.features.resources.views import submap_key
from revisit.service.ports.blobs import PLACE_BLOB, BlobStore
from revisit.service.ports.recogniser import PlaceRecogniser

log = structlog.get_logger(__name__)

LOST = RejectedLoop(RejectionReason.PLACE_LOST)
"""The verdict on a pair of which a place is damaged."""


class Comparison:
    """Verifies pairs; a damaged place is a verdict, not an error."""

    def __init__(self, blobs: BlobStore, recogniser: PlaceRecogniser) -> None:
        """`recogniser` is the method; `blobs` hold the places."""
        self._blobs = blobs
        self._recogniser = recogniser

    def verify(
        self,
        place: bytes | None,
        recalled: RecalledPlace,
        config: PipelineConfig,
        near: Matrix4 | None = None,
        *,
        near_decides: bool = True,
        expected: Matrix4 | None = None,
    ) -> PairVerdict:
        """The verdict on a query's `place` (None: damaged) and a recalled one; poses as `PlaceRecogniser.verify`."""
        submap = recalled.submap
        if place is None:
            return LOST
        try:
            blob = self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))
            return self._recogniser.verify(
                place, blob, recalled.similarity, config, near, near_decides=near_decides, expected=expected
            )
        except DataLoss as error:
            log.error("place_lost", submap=submap_key(submap).name, reason=error.message)
            return replace(LOST, message=error.message)

    def place_of(self, submap: SubmapRecord) -> bytes | None:
        """The place of a described submap; None where it is damaged."""
        try:
            return self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))
        except DataLoss as error:
            log.error("place_lost", submap=submap_key(submap).name, reason=error.message)
            return None


def require_same_model(record: MapRecord, recogniser: PlaceRecogniser) -> None:
    """Raises DescriptorModelMismatch where a map was described by another model than this worker has."""
    own = model_for_map(record, recogniser)
    if record.model_version not in (None, own):
        raise DescriptorModelMismatch(
            f"map {record.map_id} was described by model {record.model_version}, this worker has {own}"
        )
