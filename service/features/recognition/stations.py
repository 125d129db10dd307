"""Where submaps lie in their map, as the acceptance of loops asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from revisit.core.acceptance import StationInMap
from revisit.core.geometry.se3 import pose_matrix
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.features.graph.map_frames import MapFrames, MapPose
from revisit.service.ports.transactions import Transactions, UnitOfWork


def stations_in_map(
    transactions: Transactions, submaps: Sequence[SubmapRecord], as_of: MapRecord | None = None
) -> list[StationInMap | None]:
    """The poses of submaps of one map in its version in force, now or `as_of` then; None for those without one."""
    if not submaps:
        return []
    poses = transactions.read(partial(_poses_in_map, submaps=submaps, as_of=as_of)).result()
    return [None if pose is None else StationInMap(pose.frame, pose_matrix(pose.T_map)) for pose in poses]


def _poses_in_map(uow: UnitOfWork, submaps: Sequence[SubmapRecord], as_of: MapRecord | None) -> list[MapPose | None]:
    frames = MapFrames(uow, submaps[0].tenant, submaps[0].map_id, record=as_of)
    return [frames.submap(one) for one in submaps]
