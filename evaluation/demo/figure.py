"""The demo's picture: the drive with its loops, a bird's-eye image with keypoints, a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]  # matplotlib types all but this
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]  # as above
from numpy.typing import NDArray

from revisit.evaluation.demo.portrait import Portrait
from revisit.evaluation.demo.truth import LoopReport, TrueSubmap

Array = NDArray[np.float32]


@dataclass(frozen=True)
class DemoFigure:
    """What is drawn. `ways` holds T_world_sensor (n, 4, 4) by robot, `submaps` what is true of each."""

    ways: dict[str, NDArray[np.float64]]
    submaps: dict[str, TrueSubmap]
    report: LoopReport
    portrait: Portrait


def draw(figure: DemoFigure, file: Path) -> None:
    """Write the picture as PNG; its folder is made where missing."""
    file.parent.mkdir(parents=True, exist_ok=True)
    canvas = plt.figure(figsize=(19, 6.4), layout="constrained")
    grid = canvas.add_gridspec(1, 3)
    _draw_drive(canvas.add_subplot(grid[0]), figure)
    _draw_bev(canvas.add_subplot(grid[1]), figure)
    _draw_mesh(canvas.add_subplot(grid[2], projection="3d"), figure)
    canvas.savefig(file, dpi=110)
    plt.close(canvas)


def _draw_drive(axes: Axes, figure: DemoFigure) -> None:
    for robot, way in figure.ways.items():
        axes.plot(way[:, 0, 3], way[:, 1, 3], linewidth=1.2, label=f"{robot} (true way)")
    for false, colour in ((False, "tab:green"), (True, "tab:red")):
        pairs = [(judged.loop.query, judged.loop.match) for judged in figure.report.loops if judged.false == false]
        segments = [[figure.submaps[name].position[:2] for name in pair] for pair in pairs]
        label = f"{len(segments)} {'false' if false else 'true'} loops"
        axes.add_collection(LineCollection(segments, colors=colour, linewidths=0.8, alpha=0.6, label=label))
    missed = [figure.submaps[name].position for name in figure.report.missed]
    if missed:
        axes.plot(*np.array(missed)[:, :2].T, "kx", label=f"{len(missed)} missed")
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.legend(fontsize=8)
    axes.set_title("Drive and accepted loops (simulated)")


def _draw_bev(axes: Axes, figure: DemoFigure) -> None:
    half = figure.portrait.bev.shape[0] * figure.portrait.pixel_m / 2
    axes.imshow(figure.portrait.bev, origin="lower", cmap="magma", extent=(-half, half, -half, half))
    x, y = figure.portrait.keypoints.T
    axes.scatter(x, y, s=6, facecolors="none", edgecolors="cyan", linewidths=0.6)
    axes.set_xlabel("x (m)")
    axes.set_title(f"Cluster-guided BEV of one submap, {len(figure.portrait.keypoints)} keypoints")


def _draw_mesh(axes: Axes3D, figure: DemoFigure) -> None:
    faces = _near_faces(figure.portrait.vertices, figure.portrait.faces, 25.0)
    corners = figure.portrait.vertices[faces]
    height = corners[:, :, 2].mean(axis=1)
    shade = np.clip((height - height.min(initial=0.0)) / max(float(np.ptp(height)) if len(height) else 1.0, 1e-6), 0, 1)
    axes.add_collection3d(Poly3DCollection(corners, facecolors=plt.get_cmap("viridis")(shade), linewidths=0))
    axes.set(xlim=(-25, 25), ylim=(-25, 25), zlim=(-4, 12), box_aspect=(50, 50, 16))
    axes.view_init(elev=38, azim=-60)
    axes.set_title(f"Mesh of its neural map ({len(figure.portrait.faces)} triangles)")


def _near_faces(vertices: Array, faces: NDArray[np.int32], radius_m: float) -> Sequence[int] | NDArray[np.int32]:
    near = np.abs(vertices[:, :2]).max(axis=1) < radius_m
    return np.asarray(faces[near[faces].all(axis=1)], dtype=np.int32)
