"""Ambiguous loops that nothing but other loops contradicts: right ones do so where a step of odometry is broken."""

from __future__ import annotations

from collections.abc import Collection

from revisit.core.acceptance import Doubt
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.features.graph.reading import track_loop
from revisit.service.ports.map_optimiser import TrackLoop
from revisit.service.ports.transactions import UnitOfWork

_BY_OTHERS = frozenset({Doubt.PAIRWISE_INCONSISTENT, Doubt.SUPPORT_LOST})
"""Doubts that loops raise which lie across a broken step."""

_PAGE = 500
"""Loops, whose rows are as many as may be asked for at once."""


def is_doubted_by_others(loop: LoopRecord) -> bool:
    """Whether nothing but other loops speaks against an ambiguous one."""
    doubts = loop.evidence.get("doubts", {}).keys()
    return bool(doubts) and doubts <= _BY_OTHERS


def doubted_loops(uow: UnitOfWork, tenant: TenantId, map_id: str, submaps: Collection[int]) -> tuple[TrackLoop, ...]:
    """Those of a map between these submaps, by number, as a pose graph has loops."""
    found: list[TrackLoop] = []
    after: int | None = 0
    while after is not None:
        page = uow.loops.rejected(tenant, map_id, ["AMBIGUOUS"], after=after, limit=_PAGE)
        within = [one.number for one in page if one.query_number in submaps and one.match_number in submaps]
        loops = uow.loops.numbered(tenant, within).values() if within else ()
        found += [track_loop(one) for one in loops if one.T_match_query is not None and is_doubted_by_others(one)]
        after = page[-1].number if len(page) == _PAGE else None
    return tuple(found)
