"""An experiment: the results of all methods under one protocol on one sequence, as numbers in a file."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.drive_acceptance import AcceptedLoops
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.metrics import (
    LoopProtocol,
    Outcomes,
    RecognitionScores,
    best_f1,
    loop_segments,
    precision_recall,
    recall_at,
    score_recognition,
)


@dataclass(frozen=True)
class PoseErrors:
    """Metres and degrees (k,) of the first answers of a method that pass alone."""

    metres: tuple[float, ...]
    degrees: tuple[float, ...]


@dataclass(frozen=True)
class MethodResult:
    """The matches of one method.

    candidates[q]: the map submaps it ranks first, best first; score[q] of the first, None where there is none; times in
    seconds a submap; `accepted` queries whose first answer passes as a pair alone, and the errors of their poses, where
    it verifies; `loops` as the service accepts them, None where no service would run the method.
    """

    method: str
    candidates: tuple[tuple[int, ...], ...]
    score: tuple[float | None, ...]
    describe_s: float
    search_s: float
    bytes_per_submap: float
    accepted: tuple[int, ...] = ()
    poses: PoseErrors = PoseErrors((), ())
    loops: AcceptedLoops | None = None


@dataclass(frozen=True)
class Experiment:
    """The results of all methods on the same queries. Positions in metres; windows are the scan indices of a submap.

    `query_recording` and `map_recording` are names, the same where a drive is its own map; `costs` holds bytes and
    seconds of the product by part.
    """

    sequence: str
    protocol: str
    query_recording: str
    map_recording: str
    loops: LoopProtocol
    query_positions: tuple[tuple[float, ...], ...]
    map_positions: tuple[tuple[float, ...], ...]
    query_windows: tuple[tuple[int, ...], ...]
    map_windows: tuple[tuple[int, ...], ...]
    within_session: bool
    results: tuple[MethodResult, ...]
    costs: dict[str, float]

    def ground_truth(self) -> GroundTruth:
        """Which matches were allowed, and which were right."""
        queries = np.array(self.query_positions).reshape(-1, 3)
        if self.within_session:
            return GroundTruth.within_session(queries, self.loops)
        known = np.array(self.map_positions).reshape(-1, 3)
        return GroundTruth.between_sessions(queries, known, self.loops.positive_radius_m)

    def result(self, method: str) -> MethodResult:
        """The result of `method`. Raises KeyError for a method that did not take part."""
        for result in self.results:
            if result.method == method:
                return result
        raise KeyError(method)

    def write(self, file: Path) -> None:
        """Write as JSON; its folder is made where missing."""
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(dataclasses.asdict(self), allow_nan=False))

    @classmethod
    def read(cls, file: Path) -> Experiment:
        """The experiment in a file that `write` wrote."""
        fields: dict[str, Any] = json.loads(file.read_text())
        results = tuple(_result(values) for values in fields.pop("results"))
        loops = LoopProtocol(**fields.pop("loops"))
        return cls(**_frozen_fields(fields), loops=loops, results=results)


@dataclass(frozen=True)
class Scores:
    """A method's figures in one experiment."""

    recognition: RecognitionScores
    recall_at_1: float
    recall_at_5: float


def query_outcomes(result: MethodResult, ground_truth: GroundTruth) -> Outcomes:
    """One row a query: its score, whether the first candidate is right, whether there was a loop."""
    correct = [bool(ids) and bool(ground_truth.positives[query, ids[0]]) for query, ids in enumerate(result.candidates)]
    has_loop = np.asarray(ground_truth.positives.any(axis=1))
    score = [-np.inf if value is None else value for value in result.score]
    return Outcomes(np.array(score, dtype=np.float64), np.array(correct, dtype=bool), has_loop)


def classified(outcomes: Outcomes) -> NDArray[np.str_]:
    """right (TP), wrong (FP), missed (FN) or no loop (TN) of every query (n,), at the threshold of the best F1."""
    threshold = best_f1(precision_recall(outcomes))[1]
    accepted = outcomes.score >= (np.inf if threshold is None else threshold)
    kinds = np.where(outcomes.has_loop, "missed", "no loop")
    return np.where(accepted, np.where(outcomes.correct, "right", "wrong"), kinds)


def scores(result: MethodResult, ground_truth: GroundTruth) -> Scores:
    """The figures of `result`, with bootstrap intervals over loop segments."""
    rows = query_outcomes(result, ground_truth)
    ranked = [list(ids) for ids in result.candidates]
    return Scores(
        score_recognition(rows, loop_segments(rows.has_loop)),
        recall_at(ranked, ground_truth.positives, 1),
        recall_at(ranked, ground_truth.positives, 5),
    )


def _result(values: dict[str, Any]) -> MethodResult:
    poses, stored = PoseErrors(**_frozen_fields(values.pop("poses"))), values.pop("loops")
    loops = None if stored is None else AcceptedLoops(**_frozen_fields(stored))
    return MethodResult(**_frozen_fields(values), poses=poses, loops=loops)


def _frozen_fields(values: dict[str, Any]) -> dict[str, Any]:
    return {name: _frozen(value) for name, value in values.items()}


def _frozen(value: Any) -> Any:
    """Lists as tuples, at any depth."""
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
