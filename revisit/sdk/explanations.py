"""Why a submap has no loop with another one: the gate that stopped each near miss, and the value that would have passed
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from revisit.sdk.resources import LoopClosure, LoopClosureEvent, Map, SearchHit, Submap

RULES = {"LOW_SCORE": "min_score", "LOW_OVERLAP": "min_overlap", "SEEN_THROUGH": "max_seen_through"}
"""The rule of a loop policy behind each gate that has one."""

_MEASURED = {
    "LOW_SCORE": "score", "LOW_OVERLAP": "overlap", "SEEN_THROUGH": "seen_through", "NO_COMMON_REGION": "common_share"
}  # fmt: skip

TOO_NEAR = "TOO_NEAR"
"""The other submap is of the same session, which has not been `leave_distance_m` from it and come back."""

NOT_VERIFIED = "NOT_VERIFIED"
"""Other submaps were more similar when the later one came: geometry was never asked."""

KNOWN_ALREADY = "KNOWN_ALREADY"
"""Accepted loops of the later one told already where the other lies: geometry was never asked."""


class Lookups(Protocol):
    """The calls of a `Client` that an explanation needs."""

    def get_map(self, name: str) -> Map:
        """See `Client`."""
        ...

    def search(self, map_: Map, *, submap: Submap, k: int, leave_distance_m: float | None = None) -> list[SearchHit]:
        """See `Client`."""
        ...

    def loop_closures(self, map_: Map, *, state: str, session: str) -> list[LoopClosure]:
        """See `Client`."""
        ...

    def loop_closure_events(self, loop: LoopClosure) -> list[LoopClosureEvent]:
        """See `Client`."""
        ...


@dataclass(frozen=True)
class NearMiss:
    """A submap that is no loop with the one that was asked about.

    `gate` stopped it: a reason for a rejection, SET_ASIDE by the pose graph, TOO_NEAR, NOT_VERIFIED or KNOWN_ALREADY,
    where it is among as many submaps as are verified and the submap has accepted loops. Where the gate
    is a number, `measured` did not reach `threshold`, and `rule` names the setting, if there is one: with `measured` in
    its place the pair would have passed this gate, maybe not those behind it. `loop` is None where geometry was never
    asked.
    """

    submap: str
    similarity: float
    gate: str
    measured: float | None
    threshold: float | None
    rule: str | None
    loop: str | None

    @property
    def remedy(self) -> str:
        """The value that would have passed the gate, in words."""
        if self.gate == TOO_NEAR:
            return f"{self.rule} below {self.threshold:g}, or a way that comes back to it"
        if self.rule is None or self.measured is None:
            return "no setting passes it"
        return f"{self.rule} = {self.measured:g}"


def explain(client: Lookups, submap: Submap, k: int) -> list[NearMiss]:
    """The near misses among the `k` submaps most like one that is described, most similar first."""
    map_ = client.get_map("/".join(submap.name.split("/")[:2]))
    hits = client.search(map_, submap=submap, k=k)
    left = client.search(map_, submap=submap, k=k, leave_distance_m=map_.leave_distance_m)
    ranks = {hit.submap: rank for rank, hit in enumerate(left, 1)}
    loops = _loops_of(client, map_, submap, hits)
    found = (_near_miss(client, map_, ranks.get(hit.submap), hit, loops) for hit in hits)
    return [miss for miss in found if miss is not None]


def _loops_of(client: Lookups, map_: Map, submap: Submap, hits: list[SearchHit]) -> dict[str, LoopClosure]:
    """The loops of a submap with its hits, by the name of the other one; of several the last."""
    sessions = {name.rpartition("/submaps/")[0] for name in (submap.name, *(hit.submap for hit in hits))}
    loops = (loop for session in sorted(sessions) for loop in client.loop_closures(map_, state="ALL", session=session))
    pairs = ((loop, {loop.query, loop.match}) for loop in loops)
    return {next(iter(ends - {submap.name})): loop for loop, ends in pairs if submap.name in ends}


def _near_miss(
    client: Lookups, map_: Map, rank: int | None, hit: SearchHit, loops: Mapping[str, LoopClosure]
) -> NearMiss | None:
    """The gate that stopped one hit, None where none did; `loops` are those of the submap with all hits.

    `rank`: which of those that may be loops it is, the most similar first; None where it may be none.
    """
    loop = loops.get(hit.submap)
    if loop is None:
        if rank is None:
            return NearMiss(hit.submap, hit.similarity, TOO_NEAR, None, map_.leave_distance_m, "leave_distance_m", None)
        candidates = map_.loop_policy.candidates
        if candidates is not None and rank <= candidates and any(one.state == "ACCEPTED" for one in loops.values()):
            return NearMiss(hit.submap, hit.similarity, KNOWN_ALREADY, None, None, None, None)
        return NearMiss(hit.submap, hit.similarity, NOT_VERIFIED, rank, candidates, "candidates", None)
    if loop.state == "REJECTED":
        return _rejected(hit, loop)
    if loop.graph_state == "SET_ASIDE":
        distance = _distance(client.loop_closure_events(loop))
        return NearMiss(hit.submap, hit.similarity, "SET_ASIDE", distance, None, None, loop.name)
    return None


def _rejected(hit: SearchHit, loop: LoopClosure) -> NearMiss:
    gate = loop.reason or "REJECTED"
    rule = RULES.get(gate)
    evidence = loop.evidence.get("measurement", {})
    measured = evidence.get(_MEASURED.get(gate, ""))
    asked = evidence.get("enough_share") if gate == "NO_COMMON_REGION" else None
    threshold = asked if rule is None else loop.evidence.get("thresholds", {}).get(rule)
    return NearMiss(hit.submap, hit.similarity, gate, measured, threshold, rule, loop.name)


def _distance(events: list[LoopClosureEvent]) -> float | None:
    """The squared distance from the poses of the version that set a loop aside."""
    judged = [event.details.get("squared_distance") for event in events if event.kind == "JUDGED"]
    return judged[-1] if judged else None
