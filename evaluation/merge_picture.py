"""A picture of a merge: the tracks of a map before and after, and the changes between the days."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

Track = tuple[str, NDArray[np.float64]]
"""The frame of a session and the positions (n, 2) of its submaps, metres."""

COLOURS = {"VANISHED": "#c1121f", "APPEARED": "#2a9d8f"}


def draw_merge(
    path: Path, before: Mapping[str, Track], after: Mapping[str, Track], changes: Sequence[Mapping[str, Any]]
) -> None:
    """Write the picture. Sessions in other frames than the first one's are drawn pale: they have no place in it."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.0, 6.0), constrained_layout=True)
    _draw_tracks(left, before, "before")
    _draw_tracks(right, after, "after")
    for change in changes:
        _draw_change(right, change)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_tracks(axes: Axes, tracks: Mapping[str, Track], title: str) -> None:
    frame = next(iter(tracks.values()))[0] if tracks else ""
    for number, (session, (own, places)) in enumerate(tracks.items()):
        alpha = 1.0 if own == frame else 0.25
        axes.plot(places[:, 0], places[:, 1], ".-", color=f"C{number % 10}", alpha=alpha, label=session, ms=4)
    axes.set(title=title, xlabel="x, metres", ylabel="y, metres", aspect="equal")
    axes.grid(alpha=0.3)
    if tracks:
        axes.legend(fontsize=8)


def _draw_change(axes: Axes, change: Mapping[str, Any]) -> None:
    centre, extent = np.asarray(change["centre_m"][:2]), np.asarray(change["extent_m"][:2])
    corner = centre - 0.5 * extent
    colour = COLOURS[change["kind"]]
    axes.add_patch(Rectangle((corner[0], corner[1]), extent[0], extent[1], color=colour, alpha=0.5))
