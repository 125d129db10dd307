"""A picture of a fleet's drives: by odometry from unknown starts, and in the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4


@dataclass(frozen=True)
class FleetFigure:
    """Of each session its submaps by name in their order; poses by submap before and after, and in
    truth, all in the frame of the truth; loops of the map and wrong ones that were set aside, as pairs of names.
    """

    sessions: Mapping[str, Sequence[str]]
    before: Mapping[str, Matrix4]
    after: Mapping[str, Matrix4]
    truth: Mapping[str, Matrix4]
    kept: Sequence[tuple[str, str]]
    set_aside: Sequence[tuple[str, str]]
    titles: tuple[str, str]


def draw(figure: FleetFigure, file: Path) -> None:
    """Write the picture as PNG; its folder is made where missing."""
    file.parent.mkdir(parents=True, exist_ok=True)
    canvas, (left, right) = plt.subplots(1, 2, figsize=(15, 7.2), layout="constrained")
    _draw_loops(left, figure.before, figure.set_aside, "tab:red", f"{len(figure.set_aside)} wrong loops")
    _draw_ways(left, figure, figure.before)
    _draw_loops(right, figure.after, figure.kept, "tab:green", f"{len(figure.kept)} loops in the map")
    _draw_ways(right, figure, figure.after)
    for axes, title in zip((left, right), figure.titles, strict=True):
        axes.set(aspect="equal", title=title, xlabel="x (m)", ylabel="y (m)")
        axes.legend(loc="upper right", fontsize=8)
    canvas.savefig(file, dpi=75)
    plt.close(canvas)


def _draw_ways(axes: Axes, figure: FleetFigure, poses: Mapping[str, Matrix4]) -> None:
    for number, names in enumerate(figure.sessions.values()):
        axes.plot(*_positions(figure.truth, names).T, color="0.8", linewidth=5, label=None if number else "truth")
    for session, names in figure.sessions.items():
        placed = [name for name in names if name in poses]
        if placed:
            axes.plot(*_positions(poses, placed).T, linewidth=1.2, label=session)


def _draw_loops(
    axes: Axes, poses: Mapping[str, Matrix4], pairs: Sequence[tuple[str, str]], colour: str, label: str
) -> None:
    known = [pair for pair in pairs if pair[0] in poses and pair[1] in poses]
    segments = [_positions(poses, pair) for pair in known]
    axes.add_collection(LineCollection(segments, colors=colour, linewidths=0.5, alpha=0.35, label=label))


def _positions(poses: Mapping[str, Matrix4], names: Sequence[str]) -> NDArray[np.float64]:
    """Positions (n, 2) of some submaps."""
    return np.stack([poses[name][:2, 3] for name in names])
