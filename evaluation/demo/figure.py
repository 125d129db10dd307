"""The demo's picture: the drives before and after, the pair that closed the loop, a bird's-eye image, a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.layout_engine import ConstrainedLayoutEngine
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]  # matplotlib types all but this
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]  # as above
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.evaluation.demo.map_errors import MapReport, RobotTrack
from revisit.evaluation.demo.pair import PairClouds, standing
from revisit.evaluation.demo.portrait import Portrait
from revisit.evaluation.demo.truth import LoopReport

Array = NDArray[np.float32]
Floats = NDArray[np.float64]

# The colours of the page (service/web/colours.js).
ROBOTS = ("#4477AA", "#EE6677", "#228833", "#CCBB44")
QUERY, MATCH, LOOP, FALSE = "#EE7733", "#3B8EDB", "#009988", "#CC3311"
TRUTH, INK, SOFT = "#B9C0C8", "#20262D", "#66727E"
PAIR_M = 32.0
"""How far the pair is drawn around its middle."""

MESH_M = 25.0
STYLE: dict[Any, Any] = {
    "font.size": 11, "axes.titlesize": 13, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "axes.titlepad": 10, "axes.edgecolor": TRUTH, "axes.labelcolor": SOFT, "text.color": INK,
    "xtick.color": SOFT, "ytick.color": SOFT,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False, "legend.fontsize": 10,
}  # fmt: skip


@dataclass(frozen=True)
class DemoFigure:
    """The content of the picture. `pair` is None where no robot met its own way."""

    map: MapReport
    loops: LoopReport
    positions: dict[str, Floats]
    pair: PairClouds | None
    portrait: Portrait


def draw(figure: DemoFigure, file: Path) -> None:
    """Write the picture as PNG; its folder is made where missing."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        spaced = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.14)
        canvas = plt.figure(figsize=(19, 11.4), layout=spaced, facecolor="white")
        rows = canvas.add_gridspec(2, 1, height_ratios=(1.12, 1.0))
        above, below = rows[0].subgridspec(1, 3), rows[1].subgridspec(1, 4)
        _draw_drives(canvas.add_subplot(above[0]), canvas.add_subplot(above[1]), figure)
        _draw_errors(canvas.add_subplot(above[2]), figure.map)
        _draw_pair(canvas.add_subplot(below[0]), canvas.add_subplot(below[1]), figure.pair)
        _draw_bev(canvas.add_subplot(below[2]), figure.portrait)
        _draw_mesh(canvas.add_subplot(below[3], projection="3d"), figure.portrait)
        canvas.savefig(file, dpi=100)
        plt.close(canvas)


def _draw_drives(before: Axes, after: Axes, figure: DemoFigure) -> None:
    for number, track in enumerate(figure.map.tracks):
        for axes, way in ((before, track.odometry), (after, track.in_map)):
            axes.plot(*track.truth[:, :2].T, color=TRUTH, linewidth=5, solid_capstyle="round", zorder=1)
            axes.plot(*way[:, :2].T, color=ROBOTS[number % len(ROBOTS)], linewidth=1.8, zorder=3, label=track.robot)
            axes.plot(*way[0, :2], "o", color=ROBOTS[number % len(ROBOTS)], markersize=7, zorder=4)
        drift = np.stack([track.odometry[-1, :2], track.truth[-1, :2]])
        before.plot(*drift.T, color=FALSE, linewidth=1.5, linestyle=":", zorder=4)
    _draw_loops(after, figure)
    most = max(track.odometry_off_m.max() for track in figure.map.tracks)
    before.set_title(f"Before: what the robots believe, up to {most:.1f} m off")
    most = max(track.map_off_m.max() for track in figure.map.tracks)
    after.set_title(f"After: one map of both, at most {most:.2f} m off")
    for axes in (before, after):
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("x (m)")
    before.set_ylabel("y (m)")
    before.plot([], [], color=TRUTH, linewidth=5, label="the truth")
    for axes in (before, after):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_loops(axes: Axes, figure: DemoFigure) -> None:
    for false, colour in ((False, LOOP), (True, FALSE)):
        pairs = [(judged.loop.query, judged.loop.match) for judged in figure.loops.loops if judged.false == false]
        segments = [[figure.positions[name][:2] for name in pair] for pair in pairs]
        if not pairs:
            continue
        label = f"{len(segments)} {'false' if false else 'true'} loop closures"
        axes.add_collection(LineCollection(segments, colors=colour, linewidths=0.8, alpha=0.4, label=label, zorder=2))
    missed = [figure.positions[name] for name in figure.loops.missed]
    if missed:
        axes.plot(*np.array(missed)[:, :2].T, "x", color=FALSE, label=f"{len(missed)} missed", zorder=5)


def _draw_errors(axes: Axes, report: MapReport) -> None:
    for number, track in enumerate(report.tracks):
        colour = ROBOTS[number % len(ROBOTS)]
        axes.plot(track.way_m, track.odometry_off_m, color=colour, linewidth=1.5, linestyle=(0, (4, 2)))
        axes.plot(track.way_m, track.map_off_m, color=colour, linewidth=2.4, label=_ate(track))
    axes.plot([], [], color=SOFT, linewidth=1.5, linestyle=(0, (4, 2)), label="odometry, from the true start")
    axes.plot([], [], color=SOFT, linewidth=2.4, label="the map, laid on the truth as a whole")
    most = max(track.odometry_off_m.max() for track in report.tracks)
    axes.set(xlabel="way driven (m)", ylabel="off the truth (m)", ylim=(0, 1.4 * most), xlim=(0, None))
    axes.grid(axis="y", color=TRUTH, alpha=0.4, linewidth=0.6)
    axes.legend(loc="upper left")
    axes.set_title("How far off, along the way")


def _ate(track: RobotTrack) -> str:
    return f"{track.robot}: trajectory error {track.odometry_ate_m:.2f} m, in the map {track.map_ate_m:.2f} m"


def _draw_pair(before: Axes, after: Axes, clouds: PairClouds | None) -> None:
    for axes in (before, after):
        axes.set_aspect("equal")
        axes.set(xticks=[], yticks=[])
    before.set_title("The pair that closed it, by odometry")
    if clouds is None:
        return
    T_after = clouds.pair.loop.T_match_query
    after.set_title(f"... and by its loop closure, {clouds.pair.gap_m:.1f} m away")
    match, query = standing(clouds.match), standing(clouds.query)
    centre = (T_after[:2, 3]) / 2
    for axes, T_match_query in ((before, clouds.pair.T_match_query_odometry), (after, T_after)):
        for points, colour in ((match, MATCH), (se3.apply(T_match_query, query), QUERY)):
            axes.scatter(points[:, 0], points[:, 1], s=0.5, color=colour, alpha=0.25, linewidths=0, rasterized=True)
        axes.set(xlim=centre[0] + np.array([-1, 1]) * PAIR_M, ylim=centre[1] + np.array([-1, 1]) * PAIR_M)
    for label, colour in (("seen first", MATCH), ("seen again", QUERY)):
        before.scatter([], [], s=40, color=colour, label=label)
    before.legend(loc="lower left", handletextpad=0.2, frameon=True, framealpha=0.85, edgecolor="none")


def _draw_bev(axes: Axes, portrait: Portrait) -> None:
    half = portrait.bev.shape[0] * portrait.pixel_m / 2
    axes.imshow(portrait.bev, origin="lower", cmap="magma", extent=(-half, half, -half, half))
    x, y = portrait.keypoints.T
    axes.scatter(x, y, s=9, facecolors="none", edgecolors="#66CCEE", linewidths=0.7)
    axes.set(xlim=(-PAIR_M, PAIR_M), ylim=(-PAIR_M, PAIR_M), xticks=[], yticks=[])
    axes.set_title("As the method sees it, with keypoints")


def _draw_mesh(axes: Axes3D, portrait: Portrait) -> None:
    corners = portrait.vertices[_near_faces(portrait.vertices, portrait.faces, MESH_M)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    height = corners[:, :, 2].mean(axis=1)
    shade = np.clip((height - np.quantile(height, 0.02)) / max(float(np.ptp(height)), 1e-6), 0, 1)
    light = 0.55 + 0.45 * np.abs(normals @ np.array([0.35, -0.5, 0.79], dtype=np.float32))
    colours = plt.get_cmap("viridis")(0.1 + 0.85 * shade)
    colours[:, :3] *= light[:, None]
    axes.add_collection3d(Poly3DCollection(corners, facecolors=colours, linewidths=0))
    reach = 0.82 * MESH_M
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-4, 10), box_aspect=(50, 50, 17))
    axes.view_init(elev=35, azim=-60)
    axes.set_axis_off()
    axes.set_title(f"The mesh of its neural map, {len(portrait.faces):,} triangles")


def _near_faces(vertices: Array, faces: NDArray[np.int32], radius_m: float) -> NDArray[np.int32]:
    near = np.abs(vertices[:, :2]).max(axis=1) < radius_m
    return np.asarray(faces[near[faces].all(axis=1)], dtype=np.int32)
