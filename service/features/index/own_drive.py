"""The drive of a submap, as far as it decides which of its submaps may be loops (`core.acceptance.revisits`)."""

from __future__ import annotations

import numpy as np

from revisit.core.acceptance.revisits import CandidatePolicy, candidate_policy, way_read_m
from revisit.core.config import LoopConfig
from revisit.core.geometry.path import travelled_m
from revisit.service.domain.records import SubmapRecord
from revisit.service.ports.repositories import PathPoint
from revisit.service.ports.transactions import UnitOfWork

_READ_FIRST = 64
"""Submaps that are read in each direction; twice as many while their way is too short."""


def candidates_of(uow: UnitOfWork, submap: SubmapRecord, config: LoopConfig) -> CandidatePolicy:
    """The candidates of a stored submap."""
    here = PathPoint(submap.number, submap.ordinal, submap.position_m)
    before, after = (_path(uow, submap, here, way_read_m(config), back=back) for back in (True, False))
    drive = [*before[:0:-1], *after]
    positions = np.array([one.position_m for one in drive])
    ids = np.array([one.number for one in drive], dtype=np.int64)
    return candidate_policy(submap.session_number, ids, positions, len(before) - 1, config)


def _path(uow: UnitOfWork, submap: SubmapRecord, here: PathPoint, way_m: float, *, back: bool) -> list[PathPoint]:
    """The drive from a submap on, or back, for `way_m` at least or to its end."""
    of_drive = submap.tenant, submap.map_id, submap.session_id
    path, read = [here], _READ_FIRST
    while True:
        more = uow.submaps.path(*of_drive, path[-1].ordinal, read, back=back)
        path += more
        if len(more) < read or travelled_m(np.array([one.position_m for one in path]))[-1] >= way_m:
            return path
        read = len(path)
