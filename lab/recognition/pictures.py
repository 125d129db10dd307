"""The pictures of a recognition report: precision over recall, where matches were right and wrong, failed pairs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lab.recognition.comparison import PRODUCT, VERIFIED
from lab.recognition.experiment import Experiment, classified, query_outcomes
from revisit.evaluation.metrics import precision_recall

_COLOURS = {"right": "tab:green", "wrong": "tab:red", "missed": "tab:orange", "no loop": "lightgrey"}


def draw_curves(experiment: Experiment, file: Path) -> None:
    """Precision over recall of every method (paper Fig. 4); the product is drawn with thick lines."""
    figure, axes = plt.subplots(figsize=(7, 5.5), layout="constrained")
    ground_truth = experiment.ground_truth()
    for result in experiment.results:
        curve = precision_recall(query_outcomes(result, ground_truth))
        if len(curve.recall):
            own = result.method in (PRODUCT, VERIFIED)
            recall, precision = np.append(0.0, curve.recall), np.append(curve.precision[0], curve.precision)
            axes.plot(recall, precision, linewidth=2.4 if own else 1.1, label=result.method)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
    axes.set_title(f"{experiment.sequence}, {experiment.protocol}")
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend(fontsize=8, loc="lower left")
    _save(figure, file)


def draw_map(experiment: Experiment, file: Path, columns: int = 4) -> None:
    """Every method's matches at the threshold of its best F1, on the map (paper Figs. 5 and 6)."""
    rows = -(-len(experiment.results) // columns)
    figure, grid = plt.subplots(rows, columns, figsize=(4 * columns, 4 * rows), layout="constrained", squeeze=False)
    ground_truth, positions = experiment.ground_truth(), np.array(experiment.query_positions).reshape(-1, 3)
    for axes in grid.flat[len(experiment.results) :]:
        axes.axis("off")
    for axes, result in zip(grid.flat, experiment.results, strict=False):
        kinds = classified(query_outcomes(result, ground_truth))
        _draw_kinds(axes, positions, kinds)
        counts = ", ".join(f"{int((kinds == kind).sum())} {kind}" for kind in ("right", "wrong", "missed"))
        axes.set_title(f"{result.method}\n{counts}", fontsize=9)
    _save(figure, file)


def draw_pairs(pairs: Sequence[tuple[str, NDArray[np.float32], NDArray[np.float32]]], file: Path) -> None:
    """Two bird's-eye images beside one another a row: the query, and what it was or should have been matched with."""
    figure, grid = plt.subplots(len(pairs), 2, figsize=(8, 4 * len(pairs)), layout="constrained", squeeze=False)
    for row, (title, query, match) in zip(grid, pairs, strict=True):
        for axes, image, name in zip(row, (query, match), ("query", "map"), strict=True):
            axes.imshow(image, origin="lower", cmap="magma")
            axes.set_title(f"{title}\n{name}", fontsize=7)
            axes.axis("off")
    _save(figure, file)


def _draw_kinds(axes: Axes, positions: NDArray[np.float64], kinds: NDArray[np.str_]) -> None:
    for kind in ("no loop", "right", "missed", "wrong"):
        chosen = positions[kinds == kind]
        axes.scatter(chosen[:, 0], chosen[:, 1], s=5 if kind == "no loop" else 12, color=_COLOURS[kind], label=kind)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def _save(figure: Figure, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=100)
    plt.close(figure)
