"""A comparison of all methods: the same submaps and queries, one process for all descriptors of a submap."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lab.recognition.experiment import Experiment, MethodResult, PoseErrors
from lab.recognition.remembered_verdicts import remembered
from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.index import Match
from revisit.evaluation.baselines import Descriptor, PlaceRecogniser
from revisit.evaluation.cutting import Window, cut, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submap, in_processes
from revisit.evaluation.drive_acceptance import AcceptedLoops, AskedPlaces, accepted_loops, judge_drive, judging
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import LoopClosureMethod
from revisit.evaluation.matching import QueryMatches, VerificationWork, pose_error, search_map, verify_all
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.perturbations import Perturbation, turned

PRODUCT = "revisit descriptor"
VERIFIED = "revisit verified"
KEPT_CANDIDATES = 5
_RAW_BYTES_PER_POINT = 12

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class PerturbedRecording:
    """A recording, and how its submaps are perturbed before they are described."""

    recording: Recording
    perturbation: Perturbation = Perturbation()


@dataclass(frozen=True)
class Comparison:
    """Which methods are compared, and how.

    The first `candidates` of the product's descriptor are verified; 0 leaves verification out. Without a `method` only
    the baselines are compared. They get clouds divided by `scene_scale`, since their parameters are for streets; the
    method brings its own. With `verified_peers` the first candidates of each baseline are verified by the method, too.
    """

    method: LoopClosureMethod | None
    submap: SubmapConfig
    loops: LoopProtocol
    baselines: tuple[PlaceRecogniser, ...]
    candidates: int = 20
    scene_scale: float = 1.0
    seed: int = 0
    jobs: int = 1
    verified_peers: bool = False


@dataclass(frozen=True)
class ComparedSubmap:
    """A submap described by every method: by the product, and by the baselines in their order.

    `descriptors` is None where the submap could not be built; `seconds` each baseline took.
    """

    submap: DescribedSubmap
    descriptors: tuple[Descriptor, ...] | None
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class QueriesAndMap:
    """Query submaps and map submaps, with the names of their recordings.

    The same name twice: one drive, in which a query may be matched with earlier submaps only.
    """

    query_recording: str
    map_recording: str
    queries: Sequence[ComparedSubmap]
    mapped: Sequence[ComparedSubmap]

    @property
    def own_map(self) -> bool:
        """Whether both are submaps of one drive."""
        return self.query_recording == self.map_recording

    @property
    def name(self) -> str:
        """The name of the sequence in reports."""
        return self.query_recording if self.own_map else f"{self.query_recording}-in-{self.map_recording}"


def verified_name(method: str) -> str:
    """The name of a baseline with the product's verification behind it in reports."""
    return f"{method} + our verification"


def describe_recording(source: PerturbedRecording, comparison: Comparison, report: Progress) -> list[ComparedSubmap]:
    """Every submap of a recording, described by all methods."""
    windows = cut(source.recording, comparison.submap)
    work = DescriptionWork(source.recording, comparison.submap, source.perturbation, comparison.method, comparison.seed)
    described: list[ComparedSubmap] = []
    for one in in_processes(_describe, (work, comparison), list(enumerate(windows)), comparison.jobs):
        described.append(one)
        report("describe", len(described), len(windows))
    return described


def compare(protocol: str, comparison: Comparison, submaps: QueriesAndMap, report: Progress) -> Experiment:
    """Match every query by every method."""
    ground_truth = _ground_truth(submaps, comparison.loops)
    results = _product_results(submaps, ground_truth, comparison, report) if comparison.method else []
    for column, baseline in enumerate(comparison.baselines):
        matches, search_s = _baseline_matches(baseline, column, submaps, ground_truth, comparison.candidates)
        results.append(_baseline_result(baseline, column, submaps, matches, search_s))
        if comparison.method and comparison.verified_peers:
            name = verified_name(baseline.name)
            results.append(verified_result(comparison, submaps, report, matches, name))
        report("compare", column + 1, len(comparison.baselines))
    return Experiment(
        sequence=submaps.name, protocol=protocol, query_recording=submaps.query_recording,
        map_recording=submaps.map_recording, loops=comparison.loops, within_session=submaps.own_map,
        query_positions=_positions(submaps.queries), map_positions=_positions(submaps.mapped),
        query_windows=tuple(one.submap.window for one in submaps.queries),
        map_windows=tuple(one.submap.window for one in submaps.mapped),
        results=tuple(results), costs=_costs(submaps.queries),
    )  # fmt: skip


def _describe(context: tuple[DescriptionWork, Comparison], task: tuple[int, Window]) -> ComparedSubmap:
    """One submap, described by all methods; the baselines, too, get it levelled."""
    work, comparison = context
    described = describe_submap(work, task)
    if not comparison.baselines:
        return ComparedSubmap(described, (), ())
    try:
        submap, _ = load_submap(work.recording, task[1], work.config, work.perturbation)
    except RevisitError:
        return ComparedSubmap(described, None, ())
    points, descriptors, seconds = turned(submap, described.yaw).levelled().points / comparison.scene_scale, [], []
    for baseline in comparison.baselines:
        started = time.process_time()
        descriptors.append(baseline.describe(points))
        seconds.append(time.process_time() - started)
    return ComparedSubmap(described, tuple(descriptors), tuple(seconds))


def _ground_truth(submaps: QueriesAndMap, loops: LoopProtocol) -> GroundTruth:
    queries = np.array(_positions(submaps.queries)).reshape(-1, 3)
    if submaps.own_map:
        return GroundTruth.within_session(queries, loops)
    return GroundTruth.between_sessions(
        queries, np.array(_positions(submaps.mapped)).reshape(-1, 3), loops.positive_radius_m
    )


def _search(
    submaps: QueriesAndMap, ground_truth: GroundTruth, comparison: Comparison
) -> tuple[list[tuple[Match, ...]], float]:
    """The most similar allowed submaps of every query by the product's cosine, and the mean seconds of a search."""
    usable = np.array([one.submap.description is not None for one in submaps.mapped], dtype=bool)
    allowed = ground_truth.restricted_to(usable).allowed
    queries, mapped = [one.submap for one in submaps.queries], [one.submap for one in submaps.mapped]
    wanted, started = max(comparison.candidates, KEPT_CANDIDATES), time.process_time()
    found = search_map(queries, mapped, wanted, allowed, own_map=submaps.own_map)
    return found, (time.process_time() - started) / max(len(found), 1)


def _product_results(
    submaps: QueriesAndMap,
    ground_truth: GroundTruth,
    comparison: Comparison,
    report: Progress,
) -> list[MethodResult]:
    """The product's descriptor alone and, unless left out, after verification: each pair alone, and as served."""
    matches, search_s = _search(submaps, ground_truth, comparison)
    results = [_descriptor_result(submaps, matches, search_s)]
    if comparison.candidates > 0 and comparison.method is not None:
        once = dataclasses.replace(comparison, method=remembered(comparison.method))
        alone = verified_result(once, submaps, report, matches)
        results.append(dataclasses.replace(alone, loops=served_loops(once, submaps, report)))
    return results


def served_loops(comparison: Comparison, submaps: QueriesAndMap, report: Progress) -> AcceptedLoops | None:
    """The loops that the service accepts when it is driven so; None for a method that judges single pairs alone.

    Its candidates are those of the service, whatever the protocol: how many, and which submaps of a drive.
    """
    method = judging(comparison.method)
    if method is None:
        return None
    queries, mapped = [one.submap for one in submaps.queries], [one.submap for one in submaps.mapped]
    places, loop, allowed = AskedPlaces(queries, mapped, submaps.own_map), method.config.loop, None
    if submaps.own_map:
        positions = np.array(_positions(submaps.mapped)).reshape(-1, 3)
        allowed = GroundTruth.of_one_drive(positions, loop, comparison.loops.positive_radius_m).allowed
    found = search_map(queries, mapped, loop.candidates, allowed, own_map=submaps.own_map)
    drive = judge_drive(places, method, found, comparison.jobs, lambda done: report("judge", done, len(queries)))
    return accepted_loops(places, drive)


def _descriptor_result(submaps: QueriesAndMap, matches: list[tuple[Match, ...]], search_s: float) -> MethodResult:
    described = [one.submap.description for one in submaps.queries if one.submap.description is not None]
    return MethodResult(
        method=PRODUCT,
        candidates=tuple(tuple(match.id for match in found[:KEPT_CANDIDATES]) for found in matches),
        score=tuple(found[0].similarity if found else None for found in matches),
        describe_s=_median(
            [one.submap.seconds["describe"] for one in submaps.queries if one.submap.description is not None]
        ),
        search_s=search_s,
        bytes_per_submap=_mean([float(description.vector.nbytes) for description in described]),
    )


def verified_result(
    comparison: Comparison,
    submaps: QueriesAndMap,
    report: Progress,
    matches: list[tuple[Match, ...]],
    name: str = VERIFIED,
) -> MethodResult:
    """The first candidates of the matches after verification of each pair alone, with the poses of those that pass.

    Raises ValueError for a comparison without a method.
    """
    if comparison.method is None:
        raise ValueError("a method must be given to verify with")
    shift = len(submaps.mapped)
    places = [one.submap for one in [*submaps.mapped, *submaps.queries]]
    candidates = [()] * shift + [found[: comparison.candidates] for found in matches]
    verified: list[QueryMatches] = []
    work = VerificationWork(places, comparison.method, comparison.loops.positive_radius_m)
    for one in verify_all(work, candidates, comparison.jobs):
        verified.append(one)
        report("verify", max(len(verified) - shift, 0), len(matches))
    answers = verified[shift:]
    taken = [query for query, one in enumerate(answers) if one.ranked and one.ranked[0].verdict.accepted]
    errors = [
        pose_error(submaps.queries[query].submap, places[best.id], best.T_match_query)
        for query, best in ((query, answers[query].ranked[0]) for query in taken)
        if best.T_match_query is not None
    ]
    stored_places = [one.submap.description.place for one in submaps.queries if one.submap.description is not None]
    return MethodResult(
        method=name,
        candidates=tuple(tuple(item.id for item in one.ranked[:KEPT_CANDIDATES]) for one in answers),
        score=tuple(one.ranked[0].score if one.ranked else None for one in answers),
        describe_s=0.0,
        search_s=_median([one.seconds for one in answers if one.ranked]),
        bytes_per_submap=_mean([float(len(place)) for place in stored_places]),
        accepted=tuple(taken),
        poses=PoseErrors(tuple(metres for metres, _ in errors), tuple(degrees for _, degrees in errors)),
    )


def _baseline_matches(
    baseline: PlaceRecogniser, column: int, submaps: QueriesAndMap, ground_truth: GroundTruth, count: int
) -> tuple[list[tuple[Match, ...]], float]:
    """The most similar allowed submaps of every query by a baseline, and the mean seconds of a search."""
    usable = np.array([one.descriptors is not None for one in submaps.mapped], dtype=bool)
    known, found = _stacked(submaps.mapped, column), list[tuple[Match, ...]]()
    allowed = ground_truth.restricted_to(usable).allowed
    started = time.process_time()
    for query, one in enumerate(submaps.queries):
        ids = np.flatnonzero(allowed[query])
        if one.descriptors is None or len(ids) == 0:
            found.append(())
            continue
        similarity = baseline.similarities(one.descriptors[column], known[ids])
        order = np.argsort(-similarity, kind="stable")[: max(count, KEPT_CANDIDATES)]
        found.append(tuple(Match(int(ids[row]), float(similarity[row])) for row in order))
    return found, (time.process_time() - started) / max(len(found), 1)


def _baseline_result(
    baseline: PlaceRecogniser,
    column: int,
    submaps: QueriesAndMap,
    matches: list[tuple[Match, ...]],
    search_s: float,
) -> MethodResult:
    known = [one.descriptors[column] for one in submaps.mapped if one.descriptors is not None]
    return MethodResult(
        method=baseline.name,
        candidates=tuple(tuple(match.id for match in found[:KEPT_CANDIDATES]) for found in matches),
        score=tuple(found[0].similarity if found else None for found in matches),
        describe_s=_median([one.seconds[column] for one in submaps.queries if one.descriptors is not None]),
        search_s=search_s, bytes_per_submap=float(known[0].nbytes) if known else 0.0,
    )  # fmt: skip


def _stacked(described: Sequence[ComparedSubmap], column: int) -> Descriptor:
    """The descriptors (m, ...) of one baseline; zeros where a submap could not be built."""
    present = [one.descriptors[column] for one in described if one.descriptors is not None]
    empty = np.zeros_like(present[0]) if present else np.zeros(0, dtype=np.float32)
    return np.stack([empty if one.descriptors is None else one.descriptors[column] for one in described])


def _costs(described: Sequence[ComparedSubmap]) -> dict[str, float]:
    """A submap's mean bytes, of the raw points and the neural map, and median seconds of every stage."""
    places = [one.submap for one in described if one.submap.description is not None]
    costs = {
        "raw_bytes": _mean([float(place.points * _RAW_BYTES_PER_POINT) for place in places]),
        "neural_map_bytes": _mean([float(p.description.neural_map_bytes) for p in places if p.description is not None]),
    }
    stages: dict[str, list[float]] = {}
    for submap in places:
        for stage, seconds in (submap.description.seconds if submap.description is not None else {}).items():
            stages.setdefault(stage, []).append(seconds)
    return {**costs, **{f"{stage}_s": _median(seconds) for stage, seconds in stages.items()}}


def _positions(described: Sequence[ComparedSubmap]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in one.submap.position) for one in described)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0
