"""All methods side by side: the same submaps, the same question, one process for all descriptors of a submap."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.index import Match
from revisit.evaluation.baselines import Descriptor, PlaceRecogniser
from revisit.evaluation.cutting import Window, cut, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.matching import QueryMatches, VerificationWork, pose_error, verify_all
from revisit.evaluation.methods import Method
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.perturbations import Perturbation, turned
from revisit.evaluation.places import DescriptionWork, Place, describe_place, in_processes
from revisit.evaluation.protocols.question import Question
from revisit.evaluation.protocols.trial import MethodOutcome, PoseErrors, Trial

PRODUCT = "revisit descriptor"
VERIFIED = "revisit verified"
KEPT_CANDIDATES = 5
_RAW_BYTES_PER_POINT = 12

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Side:
    """A recording with what is done to it before it is described."""

    recording: Recording
    perturbation: Perturbation = Perturbation()


@dataclass(frozen=True)
class Contest:
    """Who takes part. `candidates` of the product's descriptor are verified; 0 leaves verification out.

    Without a `method` the baselines are by themselves. They see clouds divided by `scene_scale`, since their parameters
    are for streets; the method brings its own.
    """

    method: Method | None
    submap: SubmapConfig
    loops: LoopProtocol
    baselines: tuple[PlaceRecogniser, ...]
    candidates: int = 20
    scene_scale: float = 1.0
    seed: int = 0
    jobs: int = 1


@dataclass(frozen=True)
class Described:
    """A submap as every method stores it; `descriptors` is None where the submap could not be built."""

    place: Place
    descriptors: tuple[Descriptor, ...] | None
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class Sides:
    """Who asks whom, with the names of the recordings. The same name: a query may be matched with its past only."""

    query_recording: str
    map_recording: str
    queries: Sequence[Described]
    known: Sequence[Described]

    @property
    def own_map(self) -> bool:
        """Whether both are submaps of one drive."""
        return self.query_recording == self.map_recording

    @property
    def name(self) -> str:
        """What the sequence is called in reports."""
        return self.query_recording if self.own_map else f"{self.query_recording}-in-{self.map_recording}"


def describe_side(side: Side, contest: Contest, report: Progress) -> list[Described]:
    """Every submap of a side, described by all methods."""
    windows = cut(side.recording, contest.submap)
    work = DescriptionWork(side.recording, contest.submap, side.perturbation, contest.method, contest.seed)
    described: list[Described] = []
    for one in in_processes(_describe, (work, contest), list(enumerate(windows)), contest.jobs):
        described.append(one)
        report("describe", len(described), len(windows))
    return described


def hold(protocol: str, contest: Contest, sides: Sides, report: Progress) -> Trial:
    """Ask every query of every method."""
    question = _question(sides, contest.loops)
    outcomes = _product_outcomes(contest.method, sides, question, contest, report) if contest.method else []
    for column, baseline in enumerate(contest.baselines):
        outcomes.append(_baseline_outcome(baseline, column, sides, question))
        report("compare", column + 1, len(contest.baselines))
    return Trial(
        sequence=sides.name, protocol=protocol, query_recording=sides.query_recording,
        map_recording=sides.map_recording, loops=contest.loops, within_session=sides.own_map,
        query_positions=_positions(sides.queries), map_positions=_positions(sides.known),
        query_windows=tuple(one.place.window for one in sides.queries),
        map_windows=tuple(one.place.window for one in sides.known),
        outcomes=tuple(outcomes), costs=_costs(sides.queries),
    )  # fmt: skip


def _describe(context: tuple[DescriptionWork, Contest], task: tuple[int, Window]) -> Described:
    """One submap for all methods. The baselines, too, see it levelled."""
    work, contest = context
    place = describe_place(work, task)
    if not contest.baselines:
        return Described(place, (), ())
    try:
        submap, _ = load_submap(work.recording, task[1], work.config, work.perturbation)
    except RevisitError:
        return Described(place, None, ())
    points, descriptors, seconds = turned(submap, place.yaw).levelled().points / contest.scene_scale, [], []
    for baseline in contest.baselines:
        started = time.perf_counter()
        descriptors.append(baseline.describe(points))
        seconds.append(time.perf_counter() - started)
    return Described(place, tuple(descriptors), tuple(seconds))


def _question(sides: Sides, loops: LoopProtocol) -> Question:
    queries = np.array(_positions(sides.queries)).reshape(-1, 3)
    if sides.own_map:
        return Question.within_session(queries, loops)
    return Question.between_sessions(queries, np.array(_positions(sides.known)).reshape(-1, 3), loops.positive_radius_m)


def _search(sides: Sides, question: Question, contest: Contest) -> tuple[list[tuple[Match, ...]], float]:
    """The most similar allowed submaps of every query by the product's cosine, and the mean seconds of a search."""
    rows = [one.place.description.vector for one in sides.known if one.place.description is not None]
    usable = np.array([one.place.description is not None for one in sides.known], dtype=bool)
    if not rows:
        return [()] * len(sides.queries), 0.0
    known = np.zeros((len(sides.known), len(rows[0])), dtype=np.float32)
    known[usable] = np.stack(rows)
    allowed = question.only(usable).allowed
    wanted = max(contest.candidates, KEPT_CANDIDATES)
    found: list[tuple[Match, ...]] = []
    started = time.perf_counter()
    for query, one in enumerate(sides.queries):
        description, ids = one.place.description, np.flatnonzero(allowed[query])
        cosine = known[ids] @ description.vector if description is not None else np.zeros(0, dtype=np.float32)
        order = np.argsort(-cosine, kind="stable")[:wanted]
        found.append(tuple(Match(int(ids[index]), float(cosine[index])) for index in order))
    return found, (time.perf_counter() - started) / max(len(found), 1)


def _product_outcomes(
    method: Method, sides: Sides, question: Question, contest: Contest, report: Progress
) -> list[MethodOutcome]:
    """The product's descriptor alone and, unless left out, after verification."""
    matches, search_s = _search(sides, question, contest)
    outcomes = [_descriptor_outcome(sides, matches, search_s)]
    if contest.candidates > 0:
        outcomes.append(_verified_outcome(method, sides, matches, contest, report))
    return outcomes


def _descriptor_outcome(sides: Sides, matches: list[tuple[Match, ...]], search_s: float) -> MethodOutcome:
    described = [one.place.description for one in sides.queries if one.place.description is not None]
    return MethodOutcome(
        method=PRODUCT,
        candidates=tuple(tuple(match.id for match in found[:KEPT_CANDIDATES]) for found in matches),
        score=tuple(found[0].similarity if found else None for found in matches),
        describe_s=_median(
            [one.place.seconds["describe"] for one in sides.queries if one.place.description is not None]
        ),
        search_s=search_s,
        bytes_per_submap=_mean([float(description.vector.nbytes) for description in described]),
    )


def _verified_outcome(
    method: Method, sides: Sides, matches: list[tuple[Match, ...]], contest: Contest, report: Progress
) -> MethodOutcome:
    """The product's candidates after verification, with the poses of the accepted ones."""
    shift = len(sides.known)
    places = [one.place for one in [*sides.known, *sides.queries]]
    candidates = [()] * shift + [found[: contest.candidates] for found in matches]
    verified: list[QueryMatches] = []
    work = VerificationWork(places, method, contest.loops.positive_radius_m)
    for one in verify_all(work, candidates, contest.jobs):
        verified.append(one)
        report("verify", max(len(verified) - shift, 0), len(matches))
    answers = verified[shift:]
    taken = [query for query, one in enumerate(answers) if one.ranked and one.ranked[0].verdict.accepted]
    errors = [
        pose_error(sides.queries[query].place, places[best.id], best.T_match_query)
        for query, best in ((query, answers[query].ranked[0]) for query in taken)
        if best.T_match_query is not None
    ]
    signatures = [one.place.description.signature for one in sides.queries if one.place.description is not None]
    return MethodOutcome(
        method=VERIFIED,
        candidates=tuple(tuple(item.id for item in one.ranked[:KEPT_CANDIDATES]) for one in answers),
        score=tuple(one.ranked[0].score if one.ranked else None for one in answers),
        describe_s=0.0,
        search_s=_median([one.seconds for one in answers if one.ranked]),
        bytes_per_submap=_mean([float(len(signature)) for signature in signatures]),
        accepted=tuple(taken),
        poses=PoseErrors(tuple(metres for metres, _ in errors), tuple(degrees for _, degrees in errors)),
    )


def _baseline_outcome(baseline: PlaceRecogniser, column: int, sides: Sides, question: Question) -> MethodOutcome:
    usable = np.array([one.descriptors is not None for one in sides.known], dtype=bool)
    known = _stacked(sides.known, column)
    allowed = question.only(usable).allowed
    candidates: list[tuple[int, ...]] = []
    score: list[float | None] = []
    started = time.perf_counter()
    for query, one in enumerate(sides.queries):
        ids = np.flatnonzero(allowed[query])
        if one.descriptors is None or len(ids) == 0:
            candidates.append(())
            score.append(None)
            continue
        similarity = baseline.similarities(one.descriptors[column], known[ids])
        order = np.argsort(-similarity, kind="stable")[:KEPT_CANDIDATES]
        candidates.append(tuple(int(index) for index in ids[order]))
        score.append(float(similarity[order[0]]))
    return MethodOutcome(
        method=baseline.name, candidates=tuple(candidates), score=tuple(score),
        describe_s=_median([one.seconds[column] for one in sides.queries if one.descriptors is not None]),
        search_s=(time.perf_counter() - started) / max(len(candidates), 1),
        bytes_per_submap=float(known[0].nbytes) if len(known) else 0.0,
    )  # fmt: skip


def _stacked(described: Sequence[Described], column: int) -> Descriptor:
    """The descriptors (m, ...) of one baseline; zeros where a submap could not be built."""
    present = [one.descriptors[column] for one in described if one.descriptors is not None]
    empty = np.zeros_like(present[0]) if present else np.zeros(0, dtype=np.float32)
    return np.stack([empty if one.descriptors is None else one.descriptors[column] for one in described])


def _costs(described: Sequence[Described]) -> dict[str, float]:
    """A submap's mean bytes, of the raw points and the neural map, and median seconds of every stage."""
    places = [one.place for one in described if one.place.description is not None]
    costs = {
        "raw_bytes": _mean([float(place.points * _RAW_BYTES_PER_POINT) for place in places]),
        "neural_map_bytes": _mean([float(p.description.neural_map_bytes) for p in places if p.description is not None]),
    }
    stages: dict[str, list[float]] = {}
    for place in places:
        for stage, seconds in (place.description.seconds if place.description is not None else {}).items():
            stages.setdefault(stage, []).append(seconds)
    return {**costs, **{f"{stage}_s": _median(seconds) for stage, seconds in stages.items()}}


def _positions(described: Sequence[Described]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in one.place.position) for one in described)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0
