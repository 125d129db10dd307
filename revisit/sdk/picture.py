"""A map as a picture for notebooks: the ways of its sessions from above, and the loop closures between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.formats.whole_files import write_whole
from revisit.sdk.client import Client
from revisit.sdk.resources import LoopClosure, Map, Submap

WIDTH, LONGEST, MARGIN = 640.0, 640.0, 24.0
"""Pixels: of the picture, of its height at most, and around the drawing."""

COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", "#EE7733", "#009988")
"""Of sessions, told apart with any kind of colour vision (Paul Tol's schemes)."""


@dataclass(frozen=True)
class MapPicture:
    """An SVG image; a notebook shows it where it is the last value of a cell."""

    svg: str

    def _repr_svg_(self) -> str:
        """The image, as IPython asks for it."""
        return self.svg

    def save(self, file: str | Path) -> None:
        """Write the image to an .svg file. Raises OSError."""
        write_whole(Path(file), self.svg)


def picture(client: Client, map_: str | Map) -> MapPicture:
    """A map from above, z up: a line for each session and one for each accepted loop closure.

    Submaps lie where the version in force has them, those of the frame that most are in; without a version, where the
    odometry of the map's first session has its own. Raises ApiError.
    """
    submaps = [one for session in client.list_sessions(map_) for one in client.list_submaps(session)]
    placed = _placed(submaps)
    loops = [loop for loop in client.loop_closures(map_) if {loop.query, loop.match} <= placed.keys()]
    return MapPicture(_svg(placed, loops))


def _placed(submaps: Sequence[Submap]) -> dict[str, NDArray[np.float64]]:
    """Positions (2,) by name, metres, in the order of the sessions and of their drives."""
    frames = [one.in_map.frame for one in submaps if one.in_map is not None]
    if not frames:
        first = next((_session(one.name) for one in submaps), "")
        return {one.name: one.T_odom_submap[:2, 3] for one in submaps if _session(one.name) == first}
    frame = max(set(frames), key=frames.count)
    known = ((one.name, one.in_map) for one in submaps)
    return {name: pose.T_map[:2, 3] for name, pose in known if pose is not None and pose.frame == frame}


def _session(submap: str) -> str:
    return submap.partition("/submaps/")[0]


def _svg(placed: dict[str, NDArray[np.float64]], loops: Iterable[LoopClosure]) -> str:
    """The drawing; y goes up, and both axes have one scale."""
    points = np.array(list(placed.values())).reshape(-1, 2) if placed else np.zeros((1, 2))
    low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1.0)
    scale = min((WIDTH - 2 * MARGIN) / size[0], (LONGEST - 2 * MARGIN) / size[1])
    height = size[1] * scale + 2 * MARGIN
    at = {
        name: (MARGIN + scale * (x - low[0]), height - MARGIN - scale * (y - low[1])) for name, (x, y) in placed.items()
    }
    lines = [_line([at[loop.query], at[loop.match]], "#8a97a4", 1.0) for loop in loops]
    for number, (session, names) in enumerate(groupby(at, _session)):
        lines += _way(session, [at[name] for name in names], number)
    inside = "".join(lines)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:g}" height="{height:.0f}" '
        f'viewBox="0 0 {WIDTH:g} {height:.0f}" font-family="sans-serif" font-size="12">'
        f'<rect width="100%" height="100%" fill="#fbfcfd"/>{inside}{_scale_bar(scale, height)}</svg>'
    )


def _way(session: str, points: list[tuple[float, float]], number: int) -> list[str]:
    """A session: its line, its submaps, and its name where it begins."""
    colour, name = COLOURS[number % len(COLOURS)], escape(session.rpartition("/")[2])
    dots = [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colour}"/>' for x, y in points]
    x, y = points[0]
    return [_line(points, colour, 2.0), *dots, f'<text x="{x + 6:.1f}" y="{y - 6:.1f}" fill="{colour}">{name}</text>']


def _line(points: list[tuple[float, float]], colour: str, width: float) -> str:
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{corners}" fill="none" stroke="{colour}" stroke-width="{width:g}"/>'


def _scale_bar(scale: float, height: float) -> str:
    """A bar of a round length, 1, 2 or 5 times a power of ten, about 80 pixels long."""
    power = 10.0 ** np.floor(np.log10(80.0 / scale))
    metres = max(step * power for step in (1, 2, 5) if step * power * scale <= 80.0)
    end, y = WIDTH - 12.0, height - 10.0
    bar = _line([(end - metres * scale, y), (end, y)], "#5d6b79", 1.5)
    return f'{bar}<text x="{end:.0f}" y="{y - 5:.1f}" text-anchor="end" fill="#5d6b79">{metres:g} m</text>'
