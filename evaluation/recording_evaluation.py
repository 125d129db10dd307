"""`revisit evaluate`: a recording in, one row a submap and the paper's figures out."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from revisit.core.config import LoopConfig, PipelineConfig, SubmapConfig
from revisit.core.index import Match
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submaps
from revisit.evaluation.drive_acceptance import (
    AskedPlaces,
    JudgedDrive,
    accepted_loops,
    judge_drive,
    judging,
    ranked_matches,
    rule_prices,
)
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import LoopClosureMethod, RevisitMethod
from revisit.evaluation.matching import QueryMatches, RankedCandidate, VerificationWork, search_map, verify_all
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.scene import estimate_scene_scale
from revisit.evaluation.summary import summarise

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class EvaluationOptions:
    """The parameters of an evaluation. tau, stride and positive_radius in metres; jobs in processes.

    `leave_distance` (metres) is half of tau where it is None: a drive must have been so far from a place for a loop.
    `scene_scale` compares the scene with a street; None estimates it from the ranges (`evaluation.scene`).
    `ablation` is none, no-implicit, bev-only or normals-only (paper Table III); `profile` product or paper.
    """

    tau: float = SubmapConfig().tau
    stride: float = SubmapConfig().stride
    leave_distance: float | None = None
    positive_radius: float = 20.0
    perturbation: Perturbation = field(default_factory=Perturbation)
    ablation: str = "none"
    profile: str = "product"
    scene_scale: float | None = None
    candidates: int = LoopConfig().candidates
    seed: int = 0
    jobs: int = field(default_factory=lambda: os.cpu_count() or 1)

    def pipeline(self, scene_scale: float = 1.0) -> PipelineConfig:
        """The product's parameters under these options, for a scene of that scale unless the options name one."""
        return PipelineConfig().of_map(
            self.scene_scale or scene_scale,
            submap={"tau": self.tau, "stride": self.stride},
            loop={"leave_distance": self.leave_distance, "candidates": self.candidates},
            verification={},
        )


@dataclass(frozen=True)
class EvaluationResult:
    """Rows (one a submap, JSON-ready) and the summary."""

    queries: list[dict[str, Any]]
    summary: dict[str, Any]

    def write_json(self, file: Path | str) -> None:
        """Write {"queries": [...], "summary": {...}}; never NaN or infinity."""
        text = json.dumps({"queries": self.queries, "summary": self.summary}, indent=1, allow_nan=False)
        Path(file).write_text(text + "\n")


def evaluate(
    recording: Recording,
    options: EvaluationOptions,
    *,
    method: LoopClosureMethod | None = None,
    progress: Progress | None = None,
) -> EvaluationResult:
    """Describe every submap, match it against the earlier ones, verify, score. `method` defaults to the product.

    `progress(stage, done, total)` is called after every submap of the stages "describe" and "verify".
    A bad scan is left out and counted in the summary's `bad_scans`; submaps without any usable scan, and those the
    method refuses, become rows with a `failure`.
    """
    report = progress or _say_nothing
    config = options.pipeline(estimate_scene_scale(recording))
    method = method or RevisitMethod(config, options.ablation, options.profile)
    started = time.perf_counter()
    windows = cut(recording, config.submap)
    work = DescriptionWork(recording, config.submap, options.perturbation, method, options.seed)
    places: list[DescribedSubmap] = []
    for place in describe_submaps(work, windows, options.jobs):
        places.append(place)
        report("describe", len(places), len(windows))
    positions = np.array([place.position for place in places]).reshape(-1, 3)
    truth = GroundTruth.of_one_drive(positions, config.loop, options.positive_radius)
    candidates = search_map(places, places, config.loop.candidates, truth.allowed, own_map=True)
    matches, drive = _verified(places, candidates, method, options, report)
    summary = summarise(places, matches, truth.positives)
    summary["protocol"] = {
        "positive_radius_m": options.positive_radius, "leave_distance_m": config.loop.leave_distance
    }  # fmt: skip
    if drive is not None:
        asked = AskedPlaces(places, places)
        loops = accepted_loops(asked, drive)
        summary["loops"] = {"accepted": len(loops.pairs), "queries": loops.queries, "false": loops.false}
        summary["rules"] = {name: dataclasses.asdict(price) for name, price in rule_prices(asked, drive).items()}
    summary["recording"] = {"name": recording.name, "scans": len(recording)}
    summary["options"] = dataclasses.asdict(options) | {"scene_scale": config.scene_scale}
    summary["wall_seconds"] = time.perf_counter() - started
    return EvaluationResult([_row(place, match, places) for place, match in zip(places, matches, strict=True)], summary)


def _verified(
    places: list[DescribedSubmap],
    candidates: list[tuple[Match, ...]],
    method: LoopClosureMethod,
    options: EvaluationOptions,
    report: Progress,
) -> tuple[list[QueryMatches], JudgedDrive | None]:
    """The ranked candidates of each submap: those of the product judged together, of another method each by itself."""
    product = judging(method)
    if product is not None:

        def verified(done: int) -> None:
            report("verify", done, len(places))

        asked = AskedPlaces(places, places)
        drive = judge_drive(asked, product, candidates, options.jobs, verified)
        return ranked_matches(asked, candidates, drive, options.positive_radius), drive
    matches = list[QueryMatches]()
    for match in verify_all(VerificationWork(places, method, options.positive_radius), candidates, options.jobs):
        matches.append(match)
        report("verify", len(matches), len(places))
    return matches, None


def _say_nothing(_stage: str, _done: int, _total: int) -> None:
    """Progress that nobody watches."""


def _row(place: DescribedSubmap, matches: QueryMatches, places: list[DescribedSubmap]) -> dict[str, Any]:
    """The JSON row of one query; nulls where there is no candidate."""
    best = matches.ranked[0] if matches.ranked else None
    first = matches.by_similarity[0] if matches.by_similarity else None
    return {
        "id": place.id,
        "position": _numbers(place.position),
        "first_scan": place.window[0],
        "last_scan": place.window[-1],
        "failure": place.failure,
        **_best_fields(best, places),
        **_descriptor_fields(first, places),
    }


_BEST_FIELDS = (
    "candidate_id", "candidate_position", "similarity", "verified_score", "T_match_query", "verdict", "reason", "doubts"
)  # fmt: skip


def _best_fields(best: RankedCandidate | None, places: list[DescribedSubmap]) -> dict[str, Any]:
    """`similarity` belongs to the candidate after verification."""
    if best is None:
        return {**dict.fromkeys(_BEST_FIELDS), "evidence": {}}
    return {
        "candidate_id": best.id,
        "candidate_position": _numbers(places[best.id].position),
        "similarity": best.similarity,
        "verified_score": best.score,
        "T_match_query": None if best.T_match_query is None else [_numbers(row) for row in best.T_match_query],
        "verdict": "verified" if best.verdict.accepted else "rejected",
        "reason": best.verdict.reason,
        "doubts": list(best.verdict.doubts),
        "evidence": {name: value if np.isfinite(value) else None for name, value in best.verdict.evidence.items()},
    }


def _descriptor_fields(first: Match | None, places: list[DescribedSubmap]) -> dict[str, Any]:
    if first is None:
        return dict.fromkeys(("descriptor_candidate_id", "descriptor_candidate_position", "descriptor_similarity"))
    return {
        "descriptor_candidate_id": first.id,
        "descriptor_candidate_position": _numbers(places[first.id].position),
        "descriptor_similarity": first.similarity,
    }


def _numbers(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    return [float(value) for value in values]
