"""The keypoints of a loop closure's two submaps, and the pairs among them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se2 import PlanarPose
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.place import Place
from revisit.core.place.correspondences import Correspondences, correspond
from revisit.service.capacity.in_flight import Turns
from revisit.service.capacity.limits import COMPARISON_POINTS, COMPARISONS_AT_A_TIME
from revisit.service.domain.errors import NotReady
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.records import LoopRecord, SubmapRecord
from revisit.service.features.loops.calls import require_loop
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.blobs import PLACE_BLOB, BlobStore
from revisit.service.ports.storage import require_descriptor, require_submap
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class KeypointPlan:
    """The keypoints (n, 2) of a submap, metres in its upright frame; T_submap_level (4, 4) is where that lies."""

    submap: SubmapKey
    T_submap_level: Matrix4
    keypoints: NDArray[np.float64]


@dataclass(frozen=True)
class LoopKeypoints:
    """The keypoints of both submaps, the pairs (p, 2) that look alike, and which of these (p,) the pose agrees with."""

    query: KeypointPlan
    match: KeypointPlan
    pairs: NDArray[np.int64]
    agrees: NDArray[np.bool_]


class LoopKeypointReading:
    """Reads the keypoints of loop closures; they are compared again, as when the pair was verified."""

    def __init__(self, context: CallContext) -> None:
        """The policy says how near two keypoints must come."""
        self._context = context
        self._config = context.policy.pipeline.verification
        self._turns = Turns(COMPARISONS_AT_A_TIME)

    async def of(self, tenant: TenantId, map_id: str, loop_id: str) -> LoopKeypoints:
        """The keypoints of a loop closure. Raises NotFound; NotReady for a submap that is not described; DataLoss;
        RateLimited.
        """
        self._context.admission.charge_call(tenant, COMPARISON_POINTS)
        loop, query, match = await self._context.storage.read(
            partial(_pair, tenant=tenant, map_id=map_id, loop_id=loop_id)
        )
        # One at a time, beside the event loop; tenants take turns.
        async with self._turns.of(tenant):
            return await asyncio.to_thread(_read, self._context.storage.blobs, loop, query, match, self._config)


def _pair(
    uow: UnitOfWork, *, tenant: TenantId, map_id: str, loop_id: str
) -> tuple[LoopRecord, SubmapRecord, SubmapRecord]:
    loop = require_loop(uow, tenant, map_id, loop_id)
    return loop, require_submap(uow, tenant, loop.query), require_submap(uow, tenant, loop.match)


def _read(
    blobs: BlobStore, loop: LoopRecord, query: SubmapRecord, match: SubmapRecord, config: VerificationConfig
) -> LoopKeypoints:
    of_query, of_match = _place(blobs, query), _place(blobs, match)
    found = _compared(of_query, of_match, config)
    agrees = np.zeros(len(found), dtype=bool)
    if loop.T_match_query is not None:
        agrees = found.agreeing(_planar(of_query, of_match, pose_matrix(loop.T_match_query)), config)
    return LoopKeypoints(_plan(loop.query, of_query), _plan(loop.match, of_match), found.pairs, agrees)


def _place(blobs: BlobStore, submap: SubmapRecord) -> Place:
    if submap.place_sha256 is None:
        require_descriptor(submap)
        raise NotReady
    return Place.from_blob(blobs.get(submap.tenant, PLACE_BLOB, submap.place_sha256), surface=False)


def _compared(query: Place, match: Place, config: VerificationConfig) -> Correspondences:
    # Descriptors of two models cannot be compared.
    return correspond(query, match, config.correspondences if query.model == match.model else 0)


def _planar(query: Place, match: Place, T_match_query: Matrix4) -> PlanarPose:
    """The pose between the plans, in their units: lengths divided by the scene scale."""
    T_level = se3.inverse(match.frame.T_submap_upright) @ T_match_query @ query.frame.T_submap_upright
    return PlanarPose(se3.yaw(T_level), T_level[:2, 3] / match.frame.scale)


def _plan(submap: SubmapKey, place: Place) -> KeypointPlan:
    keypoints = place.keypoints.astype(np.float64) * place.frame.scale
    return KeypointPlan(submap, place.frame.T_submap_upright, keypoints)
