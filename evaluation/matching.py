"""The online protocol: each submap asks the earlier ones, then joins them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.index import ExactIndex, IndexEntry, Match, SearchFilter
from revisit.evaluation.described_submaps import DescribedSubmap, in_processes
from revisit.evaluation.loop_closure_method import LoopClosureMethod, Verdict


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate with its cosine and the verdict; T_match_query with the turns of both submaps undone.

    `score` orders candidates and queries: 0.5 to 1 for an accepted one by the verdict's score, less where the answer
    itself puts the two submaps far apart (`nearness`); below 0.5, by its cosine, for any other: a verdict that found
    too little evidence says nothing about which place is more likely.
    """

    id: int
    similarity: float
    verdict: Verdict
    T_match_query: se3.Matrix4 | None
    score: float


@dataclass(frozen=True)
class QueryMatches:
    """All candidates of a query: by falling cosine, and after verification (accepted first, then by falling score)."""

    by_similarity: tuple[Match, ...]
    ranked: tuple[RankedCandidate, ...]
    seconds: float


@dataclass(frozen=True)
class VerificationWork:
    """Everything a process needs to verify any query; submaps within `radius_m` are the same place."""

    places: Sequence[DescribedSubmap]
    method: LoopClosureMethod
    radius_m: float


def pose_error(query: DescribedSubmap, match: DescribedSubmap, T_match_query: se3.Matrix4) -> tuple[float, float]:
    """Metres and degrees of inv(T_estimated) T_true, the true pose from the recording."""
    error = se3.inverse(T_match_query) @ se3.inverse(match.T_world_submap) @ query.T_world_submap
    return float(np.linalg.norm(error[:3, 3])), float(np.degrees(se3.rotation_angle(error)))


def search_map(
    queries: Sequence[DescribedSubmap],
    mapped: Sequence[DescribedSubmap],
    count: int,
    allowed: NDArray[np.bool_] | None = None,
    *,
    own_map: bool = False,
) -> list[tuple[Match, ...]]:
    """The `count` places of the map most like each query, best first, by their row in `mapped`.

    The queries are one session: each is known after it has asked. With `own_map` they are the submaps of the map
    itself, perhaps seen otherwise, and submap n enters the map after query n has asked. allowed (queries, mapped): all
    others are left out.
    """
    index, found = _index_of([*mapped, *queries]), list[tuple[Match, ...]]()
    if not own_map:
        _enter(index, mapped, session=0)
    for number, query in enumerate(queries):
        same = own_map and query is mapped[number]
        ids = None if allowed is None else frozenset(np.flatnonzero(allowed[number]).tolist())
        only = SearchFilter(only_session=0, of_session=0 if same else 1, allowed=ids)
        vector = None if query.description is None else query.description.vector
        found.append(() if index is None or vector is None else tuple(index.search(vector, count, only)))
        if own_map:
            _enter(index, mapped[number : number + 1], session=0, first=number)
        if not same:
            _enter(index, [query], session=1, first=len(mapped) + number)
    return found


def _enter(index: ExactIndex | None, places: Sequence[DescribedSubmap], session: int, first: int = 0) -> None:
    """Add the described ones of `places`, numbered from `first` on."""
    for row, place in enumerate(places, first):
        if index is not None and place.description is not None:
            index.add([IndexEntry(row, session, row, place.position)], place.description.vector[None])


def _index_of(places: Sequence[DescribedSubmap]) -> ExactIndex | None:
    """An empty index for their descriptors; None where there are none."""
    sizes = [len(place.description.vector) for place in places if place.description is not None]
    return ExactIndex(sizes[0]) if sizes else None


def verify_all(work: VerificationWork, candidates: Sequence[tuple[Match, ...]], jobs: int) -> Iterator[QueryMatches]:
    """The verified candidates of every query, in order."""
    return in_processes(verify_query, work, list(enumerate(candidates)), jobs)


def verify_query(work: VerificationWork, task: tuple[int, tuple[Match, ...]]) -> QueryMatches:
    """Verify the candidates of one query and rank them."""
    index, matches = task
    started = time.process_time()
    ranked = [_verified(work, work.places[index], match) for match in matches]
    ranked.sort(key=lambda candidate: (-candidate.score, -candidate.similarity))
    return QueryMatches(matches, tuple(ranked), time.process_time() - started)


def _verified(work: VerificationWork, query: DescribedSubmap, match: Match) -> RankedCandidate:
    place = work.places[match.id]
    if query.description is None or place.description is None:
        raise ValueError(f"submaps {query.id} and {place.id} were matched without descriptions")
    verdict = work.method.verify(query.description.place, place.description.place, match.similarity)
    return ranked_candidate(query, place, match, verdict, work.radius_m)


def ranked_candidate(
    query: DescribedSubmap, place: DescribedSubmap, match: Match, verdict: Verdict, radius_m: float
) -> RankedCandidate:
    """A candidate with a verdict, scored; submaps within `radius_m` are the same place."""
    T_match_query = verdict.T_match_query
    if T_match_query is not None:
        T_match_query = se3.from_yaw(-place.yaw) @ T_match_query @ se3.from_yaw(query.yaw)
    if verdict.accepted:
        score = 0.5 + 0.5 * verdict.score * nearness(T_match_query, radius_m)
    else:
        score = 0.25 + 0.2499 * match.similarity
    return RankedCandidate(match.id, match.similarity, verdict, T_match_query, score)


def nearness(T_match_query: se3.Matrix4 | None, radius_m: float) -> float:
    """How much two submaps are the same place by the distance d between them: 1 / (1 + (d / radius)^4).

    Two submaps can be aligned rightly and yet lie farther apart than one place. d is the estimated
    distance, not the true one; 1 where there is none.
    """
    if T_match_query is None:
        return 1.0
    return float(1.0 / (1.0 + (np.linalg.norm(T_match_query[:3, 3]) / radius_m) ** 4))
