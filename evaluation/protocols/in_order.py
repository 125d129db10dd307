"""MapClosures on the question of a trial: a method that must see a drive's submaps in their order."""

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
from revisit.evaluation.protocols.contest import KEPT_CANDIDATES
from revisit.evaluation.protocols.question import Question
from revisit.evaluation.protocols.trial import MethodOutcome, Trial

_NOTHING = np.zeros((0, 3), dtype=np.float32)


def with_map_closures(trial: Trial, recording: Recording, config: SubmapConfig) -> Trial:
    """The trial of one drive (protocol online) with the answers of MapClosures on the same submaps beside the others.

    Raises ModuleNotFoundError where the package is not installed, ValueError for a trial between two recordings.
    """
    if not trial.within_session:
        raise ValueError("MapClosures is asked about one drive, in its order")
    started = time.perf_counter()
    found = list(map_closures.find_closures(_clouds(recording, trial.query_windows, config)))
    seconds = (time.perf_counter() - started) / max(len(found), 1)
    return dataclasses.replace(trial, outcomes=(*trial.outcomes, outcome_of(found, trial.question(), seconds)))


def outcome_of(found: Sequence[dict[int, int]], question: Question, search_s: float) -> MethodOutcome:
    """The answers of `found` (for each query, inliers by submap) that the question allows, the most inliers first.

    Learning and searching are one step of the package, and so is reading the submap here: `search_s` holds all three.
    Its memory is not counted: bytes_per_submap is 0.
    """
    ranked = []
    for query, closures in enumerate(found):
        allowed = [(-inliers, place) for place, inliers in closures.items() if question.allowed[query, place]]
        ranked.append(sorted(allowed)[:KEPT_CANDIDATES])
    return MethodOutcome(
        method=map_closures.NAME,
        candidates=tuple(tuple(place for _, place in best) for best in ranked),
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
