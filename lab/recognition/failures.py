"""The worst failures of the product: the surest wrong matches, and the loops it was least sure of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.recognition.experiment import Experiment, MethodResult, classified, query_outcomes
from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.evaluation.cutting import Window, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.perturbations import Perturbation


@dataclass(frozen=True)
class Failure:
    """A query with the map submap it was wrongly matched with, or the nearest one that it should have been."""

    query: int
    match: int
    wrong: bool
    score: float
    distance_m: float

    @property
    def title(self) -> str:
        """The failure in one line."""
        kind = "wrongly matched with" if self.wrong else "not matched with its loop"
        return f"submap {self.query} {kind} {self.match} at {self.distance_m:.0f} m, score {self.score:.2f}"


def worst_failures(experiment: Experiment, result: MethodResult, count: int) -> list[Failure]:
    """At most `count` wrong matches by falling score, and as many missed loops by rising score, at the best F1."""
    ground_truth = experiment.ground_truth()
    rows = query_outcomes(result, ground_truth)
    distance = _distances(experiment)
    kinds = classified(rows)
    wrong, missed = np.flatnonzero(kinds == "wrong"), np.flatnonzero(kinds == "missed")
    found = []
    for query in wrong[np.argsort(-rows.score[wrong], kind="stable")][:count]:
        match = result.candidates[query][0]
        found.append(Failure(int(query), match, True, float(rows.score[query]), float(distance[query, match])))
    for query in missed[np.argsort(rows.score[missed], kind="stable")][:count]:
        match = int(np.where(ground_truth.positives[query], distance[query], np.inf).argmin())
        score = max(float(rows.score[query]), 0.0)
        found.append(Failure(int(query), match, False, score, float(distance[query, match])))
    return found


def bev_image(recording: Recording, window: Window, config: PipelineConfig) -> NDArray[np.float32]:
    """The bird's-eye image (H, W) that the product makes of a submap. Raises RevisitError for unusable submaps."""
    submap, _ = load_submap(recording, window, config.submap, Perturbation())
    return describe(submap, load_packaged_models(), config).bev.image


def _distances(experiment: Experiment) -> NDArray[np.float64]:
    """Metres (q, m) between query and map submaps."""
    queries, known = (np.array(rows).reshape(-1, 3) for rows in (experiment.query_positions, experiment.map_positions))
    return np.asarray(np.linalg.norm(queries[:, None] - known[None], axis=2))
