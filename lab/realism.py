"""How near the simulated scans are to recorded ones: ranges, density, and the shape of the surroundings of a return.

`python -m lab.realism FOLDER [FOLDER ...]` prints one column a KITTI folder.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lab.command_line import run
from revisit.core.scan import Scan
from revisit.evaluation.datasets import Recording, open_recording

RANGE_EDGES_M = (0.0, 5.0, 10.0, 20.0, 40.0, 80.0)
NEIGHBOURHOOD = 16
NEIGHBOURHOOD_RADIUS_M = 0.6
SAMPLED_RETURNS = 2_000
THINNING_M = 0.1


def scan_statistics(scan: Scan, rng: np.random.Generator) -> dict[str, float]:
    """Shares in percent unless the name says otherwise.

    Returns by range; of a sample within 40 m and with a dense enough neighbourhood: how many lie on level, steep and
    slanted planes and how many in scatter (no plane: leaves, hedges, wires), and the median deviation from the plane.
    """
    ranges = np.linalg.norm(scan.points, axis=1)
    counts, _ = np.histogram(ranges, RANGE_EDGES_M)
    bands = itertools.pairwise(RANGE_EDGES_M)
    found = {"returns a scan": float(len(ranges)), "median range (m)": float(np.median(ranges))}
    for (near, far), count in zip(bands, counts, strict=True):
        found[f"{near:.0f} to {far:.0f} m"] = 100.0 * float(count) / len(ranges)
    return found | _surroundings(scan.points[ranges < 40.0].astype(np.float64), rng)


def _surroundings(points: NDArray[np.float64], rng: np.random.Generator) -> dict[str, float]:
    """Planarity and slope around sampled points (n, 3), from the spread of their nearest neighbours.

    One return a cube counts, so that a sensor of many shots a turn does not see nothing but its own rings.
    """
    _, kept = np.unique(np.floor(points / THINNING_M).astype(np.int64) @ (1, 1 << 20, 1 << 40), return_index=True)
    points = points[kept]
    sample = points[rng.choice(len(points), min(SAMPLED_RETURNS, len(points)), replace=False)]
    distance, nearest = cKDTree(points).query(sample, NEIGHBOURHOOD)
    dense = distance[:, -1] < NEIGHBOURHOOD_RADIUS_M
    around = points[nearest[dense]]
    centred = around - around.mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / NEIGHBOURHOOD)
    values = np.maximum(values, 0.0)
    scattered = values[:, 0] > 0.1 * values[:, 2]
    lined = values[:, 1] < 0.02 * values[:, 2]
    planar, upright = ~scattered & ~lined, np.abs(axes[:, 2, 0])
    return {
        "dense enough": _percent(dense),
        "level plane": _percent(planar & (upright > 0.9)),
        "steep plane": _percent(planar & (upright < 0.3)),
        "slanted plane": _percent(planar & (upright >= 0.3) & (upright <= 0.9)),
        "along a line": _percent(lined & ~scattered),
        "scatter": _percent(scattered),
        "deviation from planes (m)": float(np.median(np.sqrt(values[planar, 0]))) if planar.any() else 0.0,
    }


def _percent(chosen: NDArray[np.bool_]) -> float:
    return 100.0 * float(chosen.mean()) if len(chosen) else 0.0


def recording_statistics(recording: Recording, scans: int = 40, seed: int = 0) -> dict[str, float]:
    """The mean of `scan_statistics` over scans spread evenly over the recording."""
    rng = np.random.default_rng(seed)
    chosen = np.unique(np.linspace(0, len(recording) - 1, scans).astype(int))
    rows = [scan_statistics(recording.scan(int(index)), rng) for index in chosen]
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def table(columns: dict[str, dict[str, float]]) -> str:
    """A Markdown table with one column a recording."""
    names = list(next(iter(columns.values())))
    lines = ["| | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    for name in names:
        values = [
            f"{column[name]:.3g}" if abs(column[name]) < 1000 else f"{column[name]:.0f}" for column in columns.values()
        ]
        lines.append(f"| {name} | " + " | ".join(values) + " |")
    return "\n".join(lines)


def main(folders: list[Path]) -> None:
    """Print the table of the KITTI folders."""
    print(table({folder.name: recording_statistics(open_recording(folder, "kitti")) for folder in folders}))


if __name__ == "__main__":
    run(main)
