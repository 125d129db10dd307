"""MapClosures as a baseline: it needs the submaps of a drive in their order."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from lab.baselines import map_closures
from lab.recognition.comparison import KEPT_CANDIDATES, verified_name
from lab.recognition.experiment import Experiment, MethodResult
from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.core.index import Match
from revisit.core.scan import Points
from revisit.evaluation.cutting import Window, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.perturbations import Perturbation

LONG_NAME = f"{map_closures.NAME}, {map_closures.MAP_M:g} m maps"

Verification = Callable[[list[tuple[Match, ...]], str], MethodResult]
"""The result of verifying a method's matches, under a name."""

_NOTHING = np.zeros((0, 3), dtype=np.float32)


def with_map_closures(
    experiment: Experiment,
    recording: Recording,
    config: SubmapConfig,
    verification: Verification | None = None,
    candidates: int = KEPT_CANDIDATES,
) -> Experiment:
    """The experiment on one drive (protocol online) with the results of MapClosures beside the others.

    It is asked twice: with the submaps, and with maps of its own length around each of them, which hold what comes up
    to half that length later, too. With a `verification` its first `candidates` are verified as well.
    Raises ModuleNotFoundError where the package is not installed, ValueError for an experiment between two recordings.
    """
    if not experiment.within_session:
        raise ValueError("MapClosures is asked about one drive, in its order")
    windows, truth, results = experiment.query_windows, experiment.ground_truth(), list(experiment.results)
    reach = int(map_closures.MAP_M / 2 / config.stride)
    for name, clouds in (
        (map_closures.NAME, _clouds(recording, windows, config)),
        (LONG_NAME, _long_clouds(recording, windows, config, reach)),
    ):
        started = time.process_time()
        found = list(map_closures.find_closures(clouds))
        seconds = (time.process_time() - started) / max(len(found), 1)
        results += answers_of(matches_of(found, truth, max(candidates, KEPT_CANDIDATES)), seconds, name, verification)
    return dataclasses.replace(experiment, results=tuple(results))


def answers_of(
    ranked: list[tuple[Match, ...]], search_s: float, name: str, verification: Verification | None
) -> list[MethodResult]:
    """The result of a method, and that of the verification of its matches where there is one."""
    bare = result_of(ranked, search_s, name)
    return [bare] if verification is None else [bare, verification(ranked, verified_name(name))]


def matches_of(found: Sequence[Mapping[int, float]], ground_truth: GroundTruth, count: int) -> list[tuple[Match, ...]]:
    """The closures in `found` (for each query, inliers by submap) that the ground truth allows, most inliers first.

    The similarity of n inliers is n / (n + 1): what verification rejects is ordered by it, below all that it accepts.
    """
    ranked = []
    for query, closures in enumerate(found):
        allowed = [(-inliers, submap) for submap, inliers in closures.items() if ground_truth.allowed[query, submap]]
        ranked.append(tuple(Match(submap, inliers / (inliers - 1)) for inliers, submap in sorted(allowed)[:count]))
    return ranked


def result_of(ranked: Sequence[tuple[Match, ...]], search_s: float, name: str = map_closures.NAME) -> MethodResult:
    """The result whose matches are `ranked`, their similarity being their score.

    Learning and searching are one step of the package, and so is reading the submap here: `search_s` holds all three.
    Its memory is not counted: bytes_per_submap is 0.
    """
    return MethodResult(
        method=name,
        candidates=tuple(tuple(match.id for match in best[:KEPT_CANDIDATES]) for best in ranked),
        score=tuple(best[0].similarity if best else None for best in ranked),
        describe_s=0.0, search_s=search_s, bytes_per_submap=0.0,
    )  # fmt: skip


def _clouds(recording: Recording, windows: Sequence[Window], config: SubmapConfig) -> Iterator[Points]:
    """Every submap, levelled as for the other methods; no points where it cannot be built, so that numbers stay."""
    for window in windows:
        try:
            yield load_submap(recording, window, config, Perturbation())[0].levelled().points
        except RevisitError:
            yield _NOTHING


def _long_clouds(recording: Recording, windows: Sequence[Window], config: SubmapConfig, reach: int) -> Iterator[Points]:
    """Every submap with the `reach` before it and the `reach` - 1 after it, in its own frame, levelled."""
    levelled: dict[int, tuple[Points, se3.Matrix4]] = {}
    for number in range(len(windows)):
        around = range(max(number - reach, 0), min(number + reach, len(windows)))
        levelled = {
            one: levelled[one] if one in levelled else _placed(recording, windows[one], config) for one in around
        }
        T_own_world = se3.inverse(levelled[number][1])
        yield np.concatenate([se3.apply(T_own_world @ pose, points) for points, pose in levelled.values()]).astype(
            np.float32
        )


def _placed(recording: Recording, window: Window, config: SubmapConfig) -> tuple[Points, se3.Matrix4]:
    """The stored form of a submap in MapClosures, levelled, and its pose; no points where it cannot be built."""
    try:
        submap = load_submap(recording, window, config, Perturbation())[0].levelled()
    except RevisitError:
        return _NOTHING, recording.pose(window[len(window) // 2])
    return map_closures.in_voxels(submap.points), submap.T_odom_submap
