"""The recognition report: every experiment's tables and pictures, all methods side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.recognition.benchmark_plan import ABLATIONS
from lab.recognition.comparison import PRODUCT, VERIFIED
from lab.recognition.directions import Direction, recall_by_direction
from lab.recognition.document import Document
from lab.recognition.experiment import Experiment, MethodResult, Scores, query_outcomes, scores
from lab.recognition.failures import Failure, worst_failures
from lab.recognition.pictures import draw_curves, draw_map, draw_pairs
from revisit.evaluation.drive_acceptance import RIGHT_DEG, RIGHT_M
from revisit.evaluation.metrics import Interval, Outcomes, mean_auc

NAME = "recognition"
FAILURES_SHOWN = 3

FailurePictures = Callable[[Experiment, Failure], tuple[NDArray[np.float32], NDArray[np.float32]] | None]
"""The two bird's-eye images of a failure, None where they cannot be made."""

_TITLES = {
    "online": "Each submap asks its past",
    "rotation": "Every submap turned by a random yaw",
    "beams": "Queries cut to 16 of 64 beams, map untouched",
    "density": "Queries cut to 10 % of the points, map untouched",
    "no-implicit": "Without the implicit map (Table III)",
    "bev-only": "BEV part alone (Table III)",
    "normals-only": "Normal part alone (Table III)",
    "sessions": "One session asks another",
}


@dataclass(frozen=True)
class _Judged:
    """An experiment with the figures of its methods."""

    experiment: Experiment
    scores: dict[str, Scores]


def write_report(
    experiments: Sequence[Experiment], folder: Path, model_version: str, failure_pictures: FailurePictures | None = None
) -> tuple[Path, Path]:
    """Write recognition.md, recognition.html and their pictures into `folder`; the paths of the two documents."""
    results = [_Judged(experiment, _all_scores(experiment)) for experiment in experiments]
    document = Document("Recognition bench")
    document.paragraph(
        f"Model {model_version}. Sequences are simulated unless their name says otherwise. Intervals are 95 %, by "
        "bootstrap over loop segments. AUC and F1 as in the paper (IV-B); R@P100 is the recall over all loops at "
        "100 % precision, EP the extended precision."
    )
    _means(document, experiments)
    _changes(document, experiments)
    for protocol in dict.fromkeys(experiment.protocol for experiment in experiments):
        document.heading(_TITLES.get(protocol, protocol))
        for one in results:
            if one.experiment.protocol == protocol:
                _sequence(document, one, folder, failure_pictures)
    _directions(document, experiments)
    _poses(document, experiments)
    _times(document, experiments)
    _memory(document, experiments)
    return document.write(folder, NAME)


def _all_scores(experiment: Experiment) -> dict[str, Scores]:
    ground_truth = experiment.ground_truth()
    return {result.method: scores(result, ground_truth) for result in experiment.results}


def _means(document: Document, experiments: Sequence[Experiment]) -> None:
    """Mean AUC of every method (rows) under every protocol (columns)."""
    protocols = list(dict.fromkeys(experiment.protocol for experiment in experiments))
    methods = list(dict.fromkeys(result.method for experiment in experiments for result in experiment.results))
    document.heading("Mean AUC over the sequences")
    rows = []
    for method in methods:
        runs = [list(_runs(experiments, protocol, method).values()) for protocol in protocols]
        rows.append([method, *(f"{_interval(mean_auc(run))} ({len(run)})" if run else "-" for run in runs)])
    document.table(["method (sequences)", *protocols], rows)


def _changes(document: Document, experiments: Sequence[Experiment]) -> None:
    """The change of the product's mean AUC by each protocol, on the same drives."""
    rows = []
    for protocol in dict.fromkeys(experiment.protocol for experiment in experiments):
        for method in (PRODUCT, VERIFIED):
            plain, changed = _runs(experiments, "online", method), _runs(experiments, protocol, method)
            common = [name for name in changed if name in plain]
            if protocol != "online" and common:
                change = mean_auc([changed[name] for name in common], [plain[name] for name in common])
                rows.append([_TITLES.get(protocol, protocol), method, _interval(change), str(len(common))])
    if rows:
        document.heading("Change of the mean AUC")
        document.paragraph("Against every submap asking its past, with intervals of paired draws.")
        document.table(["what is changed", "method", "change", "sequences"], rows)


def _runs(experiments: Sequence[Experiment], protocol: str, method: str) -> dict[str, Outcomes]:
    """The query outcomes of a method under a protocol, by sequence."""
    return {
        experiment.sequence: query_outcomes(result, experiment.ground_truth())
        for experiment in experiments
        if experiment.protocol == protocol
        for result in experiment.results
        if result.method == method
    }


def _sequence(document: Document, one: _Judged, folder: Path, failure_pictures: FailurePictures | None) -> None:
    experiment = one.experiment
    any_method = next(iter(one.scores.values())).recognition
    document.heading(experiment.sequence, level=3)
    document.paragraph(f"{any_method.queries} queries, {any_method.loops} with a loop.")
    columns = ["method", "AUC", "max F1", "AP", "recall@1", "recall@5", "R@P100", "EP", "recall"]
    document.table(columns, [[name, *_figures(figures)] for name, figures in one.scores.items()])
    if experiment.protocol in ABLATIONS:
        return
    stem = f"{experiment.sequence}-{experiment.protocol}"
    curves, places = (folder / "pictures" / f"{stem}-{kind}.png" for kind in ("curves", "map"))
    draw_curves(experiment, curves)
    document.picture(curves, folder, f"Precision and recall on {experiment.sequence}")
    draw_map(experiment, places)
    document.picture(places, folder, f"Right, wrong and missed matches on {experiment.sequence} at the best F1")
    if failure_pictures is not None:
        _failures(document, experiment, folder, failure_pictures)


def _figures(figures: Scores) -> list[str]:
    known = figures.recognition
    single = (
        known.average_precision, figures.recall_at_1, figures.recall_at_5, known.recall_at_full_precision,
        known.extended_precision, known.recall_over_loops,
    )  # fmt: skip
    return [_interval(known.auc), _interval(known.max_f1), *(f"{value:.3f}" for value in single)]


def _interval(figure: Interval) -> str:
    return f"{figure.value:.3f} [{figure.low:.3f}, {figure.high:.3f}]"


def _failures(document: Document, experiment: Experiment, folder: Path, pictures: FailurePictures) -> None:
    method = VERIFIED if any(result.method == VERIFIED for result in experiment.results) else PRODUCT
    found = worst_failures(experiment, experiment.result(method), FAILURES_SHOWN)
    pairs = [(failure.title, images) for failure in found if (images := pictures(experiment, failure)) is not None]
    if not pairs:
        return
    file = folder / "pictures" / f"{experiment.sequence}-{experiment.protocol}-failures.png"
    draw_pairs([(title, *images) for title, images in pairs], file)
    document.picture(file, folder, f"Worst failures of '{method}' on {experiment.sequence}")


def _directions(document: Document, experiments: Sequence[Experiment]) -> None:
    """Recall at the first rank by the direction in which a place is passed again, over all sequences of a protocol."""
    totals: dict[tuple[str, str], dict[Direction, list[int]]] = {}
    for experiment in experiments:
        for result in experiment.results:
            kept = totals.setdefault((experiment.protocol, result.method), {one: [0, 0] for one in Direction})
            for direction, (right, count) in recall_by_direction(experiment, result).items():
                kept[direction][0] += right
                kept[direction][1] += count
    document.heading("Recall@1 by direction")
    rows = [
        [protocol, method, *(f"{right / count:.3f} ({count})" if count else "-" for right, count in kept.values())]
        for (protocol, method), kept in totals.items()
    ]
    document.table(["protocol", "method", *(f"{one} (queries)" for one in Direction)], rows)


def _poses(document: Document, experiments: Sequence[Experiment]) -> None:
    """Errors of the poses of first answers that pass as pairs alone; and the loops as the service accepts them."""
    rows = []
    for experiment in experiments:
        for result in experiment.results:
            if result.poses.metres:
                rows.append([f"{experiment.sequence}, {experiment.protocol}", *_pose_figures(result)])
    if rows:
        document.heading("First answers that pass as pairs alone")
        columns = ["sequence", "answers", "median m", "95 % m", "median deg", "95 % deg", "within 2 m, 5 deg",
                   "within 0.5 m, 1 deg", "false"]  # fmt: skip
        document.table(columns, rows)
    _served(document, experiments)


def _served(document: Document, experiments: Sequence[Experiment]) -> None:
    """How many loops the service accepts where pairs alone are accepted, and how many are false."""
    rows = []
    for experiment in experiments:
        for result in experiment.results:
            if result.loops is not None:
                loops, alone = result.loops, _pose_figures(result) if result.poses.metres else ["0"]
                counts = [alone[0], alone[-1], str(len(loops.pairs)), str(loops.queries), str(loops.false)]
                rows.append([f"{experiment.sequence}, {experiment.protocol}", *counts])
    if rows:
        document.heading("Loops as the service accepts them")
        document.paragraph(
            "With the candidates of the service, judged by all rules; several loops a query. Beside them the first "
            "answers that pass as pairs alone."
        )
        columns = ["sequence", "alone: accepted", "false", "as served: loops", "queries with a loop", "false"]
        document.table(columns, rows)


def _pose_figures(result: MethodResult) -> list[str]:
    metres, degrees = np.array(result.poses.metres), np.array(result.poses.degrees)
    good = (metres <= RIGHT_M) & (degrees <= RIGHT_DEG)
    fine = (metres <= 0.5) & (degrees <= 1.0)
    return [
        str(len(metres)), f"{np.median(metres):.3f}", f"{np.percentile(metres, 95):.3f}", f"{np.median(degrees):.3f}",
        f"{np.percentile(degrees, 95):.3f}", f"{good.mean():.4f}", f"{fine.mean():.4f}", str(int((~good).sum())),
    ]  # fmt: skip


def _times(document: Document, experiments: Sequence[Experiment]) -> None:
    """Milliseconds a submap to describe it and to search for it (paper Table IV), on the machine of this run."""
    chosen = [experiment for experiment in experiments if experiment.protocol == "online"]
    if not chosen:
        return
    document.heading("Time a submap in ms (Table IV)")
    document.paragraph(
        "Describing (median) plus searching, wall time of one process on this machine; parts in the last rows."
    )
    methods = list(dict.fromkeys(result.method for experiment in chosen for result in experiment.results))
    rows = [[method, *(_milliseconds(experiment, method) for experiment in chosen)] for method in methods]
    stages = list(dict.fromkeys(stage for experiment in chosen for stage in experiment.costs if stage.endswith("_s")))
    rows += [
        [f"{PRODUCT}: {stage[:-2]}", *(f"{1e3 * experiment.costs.get(stage, 0.0):.1f}" for experiment in chosen)]
        for stage in stages
    ]
    document.table(["method", *(experiment.sequence for experiment in chosen)], rows)


def _milliseconds(experiment: Experiment, method: str) -> str:
    for result in experiment.results:
        if result.method == method:
            return f"{1e3 * result.describe_s:.1f} + {1e3 * result.search_s:.1f}"
    return "-"


def _memory(document: Document, experiments: Sequence[Experiment]) -> None:
    """Megabytes of a whole sequence: raw submaps and their stored forms (paper Table V)."""
    chosen = [experiment for experiment in experiments if experiment.protocol == "online"]
    if not chosen:
        return
    document.heading("Memory in MB (Table V)")
    rows = []
    for experiment in chosen:
        count = len(experiment.query_positions) / 1e6
        raw, neural = (count * experiment.costs[name] for name in ("raw_bytes", "neural_map_bytes"))
        kept = [
            count * result.bytes_per_submap for result in experiment.results if result.method in (PRODUCT, VERIFIED)
        ]
        share = f"{neural:.1f} ({neural / raw:.1%})" if raw else "-"
        rows.append([experiment.sequence, f"{raw:.1f}", share, *(f"{size:.1f}" for size in kept)])
    document.table(["sequence", "raw float32 submaps", "neural maps", "descriptors", "signatures"], rows)
    document.paragraph("Bytes a submap of the other methods' descriptors:")
    methods = {result.method: result.bytes_per_submap for experiment in chosen for result in experiment.results}
    document.table(["method", "kB"], [[method, f"{size / 1e3:.1f}"] for method, size in methods.items()])
