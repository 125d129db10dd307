"""Ambiguous loops that nothing but other loops contradicts: right ones do so where a step of odometry is broken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from revisit.core.acceptance import Doubt
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pose_graph.faults import LEAST_LOOPS
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.features.graph.reading import track_loop
from revisit.service.ports.map_optimiser import MapGraph, OptimisedMap, TrackLoop
from revisit.service.ports.transactions import UnitOfWork

_BY_OTHERS = frozenset({Doubt.PAIRWISE_INCONSISTENT, Doubt.SUPPORT_LOST})
"""Doubts that loops raise which lie across a broken step."""

ELSEWHERE_M, ELSEWHERE_RAD = 1.0, float(np.radians(5.0))
"""By how much a loop and a map differ that a broken step lies between."""

LOOPS_AT_ONCE = 500
"""Loops, whose rows and submaps are as many as may be asked for at once."""


def is_doubted_by_others(loop: LoopRecord) -> bool:
    """Whether nothing but other loops speaks against an ambiguous one."""
    doubts = loop.evidence.get("doubts", {}).keys()
    return bool(doubts) and doubts <= _BY_OTHERS


def doubted_loops(uow: UnitOfWork, tenant: TenantId, map_id: str) -> tuple[TrackLoop, ...]:
    """Those of a map, as a pose graph has loops."""
    found: list[TrackLoop] = []
    after: int | None = 0
    while after is not None:
        page = uow.loops.rejected(tenant, map_id, ["AMBIGUOUS"], after=after, limit=LOOPS_AT_ONCE)
        loops = uow.loops.numbered(tenant, [one.number for one in page]).values() if page else ()
        found += [track_loop(one) for one in loops if one.T_match_query is not None and is_doubted_by_others(one)]
        after = page[-1].number if len(page) == LOOPS_AT_ONCE else None
    return tuple(found)


def within_frames(graph: MapGraph, optimised: OptimisedMap, doubted: Iterable[TrackLoop]) -> tuple[TrackLoop, ...]:
    """Those of these loops whose ends lie in one frame of a solution."""
    tracks = zip(graph.tracks, optimised.tracks, strict=True)
    frame = {number: solved.anchor for track, solved in tracks for number in track.submaps}
    joined = ((one, frame.get(one.match), frame.get(one.query)) for one in doubted)
    return tuple(one for one, match, query in joined if match == query and match is not None)


def contradicted(graph: MapGraph, optimised: OptimisedMap, doubted: Iterable[TrackLoop]) -> frozenset[int]:
    """The sessions, by number, that LEAST_LOOPS of these loops, `within_frames`, say to lie elsewhere."""
    poses, session = dict[int, Matrix4](), dict[int, int]()
    for track, solved in zip(graph.tracks, optimised.tracks, strict=True):
        poses |= zip(track.submaps, solved.T_map_submap, strict=True)
        session |= dict.fromkeys(track.submaps, track.session_number)
    count = Counter[int]()
    for loop in doubted:
        apart = se3.inverse(poses[loop.match] @ loop.T_match_query) @ poses[loop.query]
        if np.linalg.norm(apart[:3, 3]) > ELSEWHERE_M or se3.rotation_angle(apart) > ELSEWHERE_RAD:
            count.update({session[loop.match], session[loop.query]})
    return frozenset(number for number, loops in count.items() if loops >= LEAST_LOOPS)
