"""The picture of an inspected recording: its path from above, and one scan where the odometry puts it."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from revisit.core.scan import Scan
from revisit.evaluation.datasets import Recording
from revisit.evaluation.inspection import Inspection

MAX_POINTS = 20_000


def draw_inspection(recording: Recording, inspection: Inspection, file: Path) -> None:
    """Write the picture; its format is the file's suffix."""
    figure, (path, above, aside) = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    positions = np.array([recording.pose(index)[:3, 3] for index in range(len(recording))])
    path.plot(positions[:, 0], positions[:, 1], linewidth=1)
    path.plot(*positions[0, :2], "o", label="first scan")
    path.legend()
    _labelled(path, "path, from above", "x [m]", "y [m]")
    if inspection.sample:
        _scan(above, inspection.sample[0], 1)
        _scan(aside, inspection.sample[0], 2)
    _labelled(above, "one scan, from above", "x [m]", "y [m]")
    _labelled(aside, "the same from the side: the ground must lie below", "x [m]", "z [m]")
    figure.suptitle(", ".join(finding.code for finding in inspection.findings) or "nothing suspicious")
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _scan(axes: Axes, scan: Scan, vertical: int) -> None:
    """The scan's points, turned as the odometry says, seen along an axis; the sensor is a cross."""
    points = scan.points[:: max(1, len(scan.points) // MAX_POINTS)] @ scan.T_odom_sensor[:3, :3].T
    axes.scatter(points[:, 0], points[:, vertical], c=points[:, 2], s=0.3, rasterized=True)
    axes.plot(0.0, 0.0, "rx")


def _labelled(axes: Axes, title: str, horizontal: str, vertical: str) -> None:
    axes.set(title=title, xlabel=horizontal, ylabel=vertical, aspect="equal")
