"""The acceptance rules on a drive that is evaluated: pairs verified in turn, claims judged as in the service."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from revisit.core.acceptance import (
    Drive,
    LoopClaim,
    PredictedPoses,
    Station,
    accept,
    stride_of_drive,
    submaps_asked,
    verify_in_turn,
    without_waiting,
)
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.index import Match
from revisit.core.verification import InitialPose, PairVerdict, VerifiedLoop
from revisit.evaluation.described_submaps import DescribedSubmap, in_processes
from revisit.evaluation.loop_closure_method import verdict_of_pair
from revisit.evaluation.matching import QueryMatches, RankedCandidate, pose_error, ranked_candidate

RIGHT_M, RIGHT_DEG = 2.0, 5.0
"""A pose farther off is false."""


@runtime_checkable
class PairMethod(Protocol):
    """A method whose pairs can be judged together: the product, under any profile."""

    @property
    def config(self) -> PipelineConfig:
        """Its parameters."""

    def verify_pair(
        self, query: bytes, match: bytes, similarity: float, initial: InitialPose | None = None
    ) -> PairVerdict:
        """The verdict on a pair by itself."""


def judging(method: object) -> PairMethod | None:
    """The method where its pairs can be judged together; None for one that judges each alone."""
    return method if isinstance(method, PairMethod) else None


@dataclass(frozen=True)
class AskedPlaces:
    """The submaps of a drive that ask, in their order, and those that are asked: of the same drive, or of another."""

    queries: Sequence[DescribedSubmap]
    mapped: Sequence[DescribedSubmap]
    one_drive: bool = True

    def query(self, number: int) -> Station:
        """The station of a query."""
        return _station(self.queries[number], 0 if self.one_drive else 1)

    def match(self, row: int) -> Station:
        """The station of a submap that is asked."""
        return _station(self.mapped[row], 0)


@dataclass(frozen=True)
class JudgedCandidate:
    """A candidate of a query: its row in the map, its cosine, and the claim on it."""

    match: Match
    claim: LoopClaim


@dataclass(frozen=True)
class JudgedDrive:
    """All submaps of a drive with their claims as they stand after its last one; seconds by query."""

    candidates: list[list[JudgedCandidate]]
    seconds: list[float]


@dataclass(frozen=True)
class AcceptedLoops:
    """The loops of a drive as the service accepts them: (query, match), and how far each pose is off."""

    pairs: tuple[tuple[int, int], ...]
    metres: tuple[float, ...]
    degrees: tuple[float, ...]

    @property
    def queries(self) -> int:
        """How many queries have a loop."""
        return len({query for query, _ in self.pairs})

    @property
    def false(self) -> int:
        """How many loops have a false pose."""
        return sum(not is_right(*error) for error in zip(self.metres, self.degrees, strict=True))


@dataclass(frozen=True)
class RulePrice:
    """Cost and gain of a doubt on a drive: pairs that passed by themselves with a right pose, and a wrong one."""

    right_lost: int
    false_stopped: int


@dataclass(frozen=True)
class _DriveWork:
    places: AskedPlaces
    method: PairMethod


def is_right(metres: float, degrees: float) -> bool:
    """Whether a pose that is off by so much is right."""
    return metres <= RIGHT_M and degrees <= RIGHT_DEG


def judge_drive(
    places: AskedPlaces,
    method: PairMethod,
    candidates: Sequence[tuple[Match, ...]],
    jobs: int,
    progress: Callable[[int], None],
) -> JudgedDrive:
    """Verify and judge the candidates of each query, in the order of the drive; progress(queries verified)."""
    work, verified = _DriveWork(places, method), list[tuple[dict[int, PairVerdict], float]]()
    for one in in_processes(_verify_query, work, list(enumerate(candidates)), jobs):
        verified.append(one)
        progress(len(verified))
    return _judged(work, candidates, verified)


def _verify_query(work: _DriveWork, task: tuple[int, tuple[Match, ...]]) -> tuple[dict[int, PairVerdict], float]:
    """The verdicts on the candidates of a query by row, those left out whose pose others predict; CPU seconds."""
    number, matches = task
    started = time.process_time()
    predicted = PredictedPoses([work.places.match(one.id) for one in matches], work.method.config)

    def verify(row: int, initial: InitialPose | None) -> PairVerdict:
        return _verified(work, number, matches[row], initial)

    verdicts = verify_in_turn(predicted, len(matches), verify)
    return verdicts, time.process_time() - started


def _verified(work: _DriveWork, query: int, match: Match, initial: InitialPose | None) -> PairVerdict:
    asked, known = work.places.queries[query].description, work.places.mapped[match.id].description
    if asked is None or known is None:
        raise ValueError(f"submaps {query} and {match.id} were matched without descriptions")
    return work.method.verify_pair(asked.place, known.place, match.similarity, initial)


def _judged(
    work: _DriveWork,
    candidates: Sequence[tuple[Match, ...]],
    verified: Sequence[tuple[dict[int, PairVerdict], float]],
) -> JudgedDrive:
    judged = list[list[JudgedCandidate]]()
    for number, (matches, (verdicts, _)) in enumerate(zip(candidates, verified, strict=True)):
        query = work.places.query(number)
        new = [
            JudgedCandidate(matches[row], LoopClaim(query, work.places.match(matches[row].id), verdict))
            for row, verdict in verdicts.items()
        ]
        judged.append(_accepted(work, number, new, judged))
    return JudgedDrive([_at_the_end(one) for one in judged], [seconds for _, seconds in verified])


def _at_the_end(candidates: list[JudgedCandidate]) -> list[JudgedCandidate]:
    """The candidates of a query once its drive has ended: none waits for it to go on."""
    claims = without_waiting([one.claim for one in candidates])
    return [dataclasses.replace(one, claim=claim) for one, claim in zip(candidates, claims, strict=True)]


def _accepted(
    work: _DriveWork, number: int, new: list[JudgedCandidate], judged: list[list[JudgedCandidate]]
) -> list[JudgedCandidate]:
    """The candidates of a query judged with its drive before it, whose earlier claims are revised in place."""
    config, first = work.method.config, max(0, number - submaps_asked(work.method.config))
    where = [(query, row) for query in range(first, number) for row, one in enumerate(judged[query]) if one.claim.tells]
    before, query = [work.places.query(one) for one in range(first, number)], work.places.query(number)
    drive = Drive([judged[one][row].claim for one, row in where], stride_of_drive(query, before, config))
    pairs = [*((one, judged[one][row].match) for one, row in where), *((number, one.match) for one in new)]
    decided = accept([one.claim for one in new], drive, config, lambda row, near: _verified(work, *pairs[row], near))
    for row, claim in decided.revised.items():
        one, place = where[row]
        judged[one][place] = dataclasses.replace(judged[one][place], claim=claim)
    return [dataclasses.replace(one, claim=claim) for one, claim in zip(new, decided.new, strict=True)]


def _station(place: DescribedSubmap, drive: int) -> Station:
    """A submap on its drive, in the frame that it was described in: its pose is its odometry."""
    return Station(drive, place.id, place.T_world_submap @ se3.from_yaw(-place.yaw))


def accepted_loops(places: AskedPlaces, drive: JudgedDrive) -> AcceptedLoops:
    """The loops of a drive whose true poses are known."""
    pairs, errors = list[tuple[int, int]](), list[tuple[float, float]]()
    for number, judged in enumerate(drive.candidates):
        for one in judged:
            if one.claim.accepted:
                pairs.append((number, one.match.id))
                errors.append(_error(places, number, one))
    metres, degrees = zip(*errors, strict=True) if errors else ((), ())
    return AcceptedLoops(tuple(pairs), metres, degrees)


def ranked_matches(
    places: AskedPlaces, candidates: Sequence[tuple[Match, ...]], drive: JudgedDrive, radius_m: float
) -> list[QueryMatches]:
    """The judged candidates of each query, ranked as `matching.verify_query` ranks them."""
    found = []
    for number, (matches, judged) in enumerate(zip(candidates, drive.candidates, strict=True)):
        ranked = [_ranked(places, number, one, radius_m) for one in judged]
        ranked.sort(key=lambda candidate: (-candidate.score, -candidate.similarity))
        found.append(QueryMatches(matches, tuple(ranked), drive.seconds[number]))
    return found


def _ranked(places: AskedPlaces, number: int, judged: JudgedCandidate, radius_m: float) -> RankedCandidate:
    claim = judged.claim
    verdict = dataclasses.replace(verdict_of_pair(claim.verdict), reason=None if claim.accepted else str(claim.reason))
    verdict = dataclasses.replace(verdict, doubts=tuple(doubt.value for doubt in claim.doubts))
    query, match = places.queries[number], places.mapped[judged.match.id]
    return ranked_candidate(query, match, judged.match, verdict, radius_m)


def rule_prices(places: AskedPlaces, drive: JudgedDrive) -> dict[str, RulePrice]:
    """Right loops lost and false ones stopped by each doubt on a drive whose true poses are known."""
    lost, stopped = Counter[str](), Counter[str]()
    for number, judged in enumerate(drive.candidates):
        for one in judged:
            if isinstance(one.claim.verdict, VerifiedLoop) and not one.claim.accepted:
                counts = lost if is_right(*_error(places, number, one)) else stopped
                counts.update(doubt.value for doubt in one.claim.doubts)
    return {name: RulePrice(lost[name], stopped[name]) for name in sorted(lost.keys() | stopped.keys())}


def _error(places: AskedPlaces, number: int, judged: JudgedCandidate) -> tuple[float, float]:
    """How far the pose of a claim is off, metres and degrees; infinitely where it has none."""
    query, match, T_match_query = places.queries[number], places.mapped[judged.match.id], judged.claim.T_match_query
    if T_match_query is None:
        return float("inf"), float("inf")
    return pose_error(query, match, se3.from_yaw(-match.yaw) @ T_match_query @ se3.from_yaw(query.yaw))
