"""MapClosures as a baseline: it needs the submaps of a drive in their order."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.scan import Points
from revisit.evaluation.baselines import map_closures
from revisit.evaluation.cutting import Window, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.protocols.comparison import KEPT_CANDIDATES
from revisit.evaluation.protocols.experiment import Experiment, MethodResult
from revisit.evaluation.protocols.ground_truth import GroundTruth

_NOTHING = np.zeros((0, 3), dtype=np.float32)


def with_map_closures(experiment: Experiment, recording: Recording, config: SubmapConfig) -> Experiment:
    """The experiment on one drive (protocol online) with the results of MapClosures beside the others.

    Raises ModuleNotFoundError where the package is not installed, ValueError for an experiment between two recordings.
    """
    if not experiment.within_session:
        raise ValueError("MapClosures is asked about one drive, in its order")
    started = time.perf_counter()
    found = list(map_closures.find_closures(_clouds(recording, experiment.query_windows, config)))
    seconds = (time.perf_counter() - started) / max(len(found), 1)
    return dataclasses.replace(
        experiment, results=(*experiment.results, result_of(found, experiment.ground_truth(), seconds))
    )


def result_of(found: Sequence[dict[int, int]], ground_truth: GroundTruth, search_s: float) -> MethodResult:
    """The closures in `found` (for each query, inliers by submap) that the ground truth allows, most inliers first.

    Learning and searching are one step of the package, and so is reading the submap here: `search_s` holds all three.
    Its memory is not counted: bytes_per_submap is 0.
    """
    ranked = []
    for query, closures in enumerate(found):
        allowed = [(-inliers, submap) for submap, inliers in closures.items() if ground_truth.allowed[query, submap]]
        ranked.append(sorted(allowed)[:KEPT_CANDIDATES])
    return MethodResult(
        method=map_closures.NAME,
        candidates=tuple(tuple(submap for _, submap in best) for best in ranked),
        score=tuple(float(-best[0][0]) if best else None for best in ranked),
        describe_s=0.0, search_s=search_s, bytes_per_submap=0.0,
    )  # fmt: skip


def _clouds(recording: Recording, windows: Sequence[Window], config: SubmapConfig) -> Iterator[Points]:
    """Every submap, levelled as for the other methods; no points where it cannot be built, so that numbers stay."""
    for window in windows:
        try:
            yield load_submap(recording, window, config, Perturbation())[0].levelled().points
        except RevisitError:
            yield _NOTHING
