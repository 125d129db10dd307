"""Recognition on a real drive without loops: even keyframes are the map, odd ones come again as turned queries.

Both halves see the same streets at the same time, so this tests surfaces, descriptors and alignment on real scans, not
change over time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.recognition.remembered_verdicts import remembered
from revisit.evaluation.baselines import PlaceRecogniser, ScanContext
from revisit.evaluation.cutting import Window, cut, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submaps, in_processes
from revisit.evaluation.drive_acceptance import (
    AcceptedLoops,
    AskedPlaces,
    accepted_loops,
    is_right,
    judge_drive,
    judging,
)
from revisit.evaluation.loop_closure_method import LoopClosureMethod, RevisitMethod
from revisit.evaluation.matching import QueryMatches, VerificationWork, pose_error, search_map, verify_all
from revisit.evaluation.perturbations import turned
from revisit.evaluation.recording_evaluation import EvaluationOptions
from revisit.evaluation.scene import estimate_scene_scale


@dataclass(frozen=True)
class InterleavedResult:
    """Shares 0..1 of the queries whose first match lies within `radius_m`.

    accepted: first matches that pass as pairs alone, and the median errors of their poses; accepted_wrong of these
    farther away than `radius_m`; accepted_false those whose pose is false. loops, false_loops: as the service accepts
    them, None for a method that judges single pairs alone.
    """

    queries: int
    map_submaps: int
    radius_m: float
    descriptor_recall_at_1: float
    verified_recall_at_1: float
    accepted: int
    accepted_wrong: int
    accepted_false: int
    loops: int | None
    false_loops: int | None
    median_error_m: float | None
    median_error_deg: float | None
    baselines: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """The figures as plain numbers."""
        return dataclasses.asdict(self)


def evaluate_interleaved(
    recording: Recording,
    options: EvaluationOptions,
    *,
    radius_m: float = 10.0,
    method: LoopClosureMethod | None = None,
    baselines: tuple[PlaceRecogniser, ...] = (ScanContext(),),
) -> InterleavedResult:
    """recall@1 within `radius_m` of odd-keyframe submaps among even-keyframe submaps, both turned at random.

    Turning uses `options.perturbation.rotate_seed`, or 0 where it is None. Raises as reading the recording does.
    """
    config = options.pipeline(estimate_scene_scale(recording))
    method = remembered(method or RevisitMethod(config, options.ablation, options.profile))
    seed = options.perturbation.rotate_seed
    perturbation = dataclasses.replace(options.perturbation, rotate_seed=0 if seed is None else seed)
    maps = cut(recording, config.submap, range(0, len(recording), 2))
    windows = maps + cut(recording, config.submap, range(1, len(recording), 2))
    work = DescriptionWork(recording, config.submap, perturbation, method, options.seed)
    places = list(describe_submaps(work, windows, options.jobs))
    halves = AskedPlaces(places[len(maps) :], places[: len(maps)], one_drive=False)
    found_places = search_map(halves.queries, halves.mapped, config.loop.candidates)
    candidates = [*[()] * len(maps), *found_places]
    matches = list(verify_all(VerificationWork(places, method, radius_m), candidates, options.jobs))[len(maps) :]
    found = _baseline_matches(baselines, work, windows, len(maps), options.jobs)
    loops, product = None, judging(method)
    if product is not None:
        loops = accepted_loops(halves, judge_drive(halves, product, found_places, options.jobs, lambda _: None))
    return _score(halves, matches, loops, found, radius_m)


def _score(
    places: AskedPlaces,
    matches: list[QueryMatches],
    loops: AcceptedLoops | None,
    found: dict[str, list[int]],
    radius_m: float,
) -> InterleavedResult:
    """All figures; found[baseline] is the map submap of every query."""
    queries, mapped = places.queries, places.mapped
    by_cosine = [_within(query, mapped, m.by_similarity[0].id if m.by_similarity else None, radius_m)
                 for query, m in zip(queries, matches, strict=True)]  # fmt: skip
    by_score = [_within(query, mapped, m.ranked[0].id if m.ranked else None, radius_m)
                for query, m in zip(queries, matches, strict=True)]  # fmt: skip
    accepted = [bool(m.ranked) and m.ranked[0].verdict.accepted for m in matches]
    errors = np.array([
        pose_error(query, mapped[m.ranked[0].id], m.ranked[0].T_match_query)
        for query, m, taken in zip(queries, matches, accepted, strict=True)
        if taken and m.ranked[0].T_match_query is not None
    ]).reshape(-1, 2)  # fmt: skip
    baselines = {
        name: _share([_within(query, mapped, match, radius_m) for query, match in zip(queries, rows, strict=True)])
        for name, rows in found.items()
    }
    return InterleavedResult(
        queries=len(queries), map_submaps=len(mapped), radius_m=radius_m,
        descriptor_recall_at_1=_share(by_cosine), verified_recall_at_1=_share(by_score), accepted=sum(accepted),
        accepted_wrong=sum(taken and not right for taken, right in zip(accepted, by_score, strict=True)),
        accepted_false=sum(not is_right(*error) for error in errors.tolist()),
        loops=None if loops is None else len(loops.pairs), false_loops=None if loops is None else loops.false,
        median_error_m=float(np.median(errors[:, 0])) if len(errors) else None,
        median_error_deg=float(np.median(errors[:, 1])) if len(errors) else None, baselines=baselines,
    )  # fmt: skip


def _within(query: DescribedSubmap, places: Sequence[DescribedSubmap], match: int | None, radius_m: float) -> bool:
    return match is not None and bool(np.linalg.norm(places[match].position - query.position) <= radius_m)


def _share(flags: list[bool]) -> float:
    return float(np.mean(flags)) if flags else 0.0


def _baseline_matches(
    baselines: tuple[PlaceRecogniser, ...], work: DescriptionWork, windows: list[Window], map_count: int, jobs: int
) -> dict[str, list[int]]:
    """The map submap that every baseline finds for every query, on the same turned submaps."""
    described = list(in_processes(_describe_baselines, (work, baselines), list(enumerate(windows)), jobs))
    found = {}
    for column, baseline in enumerate(baselines):
        vectors = np.stack([row[column] for row in described])
        known = vectors[:map_count]
        found[baseline.name] = [int(baseline.similarities(query, known).argmax()) for query in vectors[map_count:]]
    return found


def _describe_baselines(
    context: tuple[DescriptionWork, tuple[PlaceRecogniser, ...]], task: tuple[int, Window]
) -> list[NDArray[np.float32]]:
    work, baselines = context
    index, window = task
    submap, _ = load_submap(work.recording, window, work.config, work.perturbation)
    points = turned(submap, work.perturbation.yaw(index)).points
    return [baseline.describe(points) for baseline in baselines]
