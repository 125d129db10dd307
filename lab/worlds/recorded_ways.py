"""The way of a recorded drive, and the streets below it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from revisit.evaluation.simulator.blocks import Floats
from revisit.evaluation.simulator.paths import Path


def kitti_path(poses: ArrayLike) -> Path:
    """The way over ground of KITTI camera poses (n, 12): camera x to the right and z ahead become x ahead, y left."""
    translation = np.asarray(poses, dtype=np.float64).reshape(-1, 3, 4)[:, :, 3]
    return Path.through(np.column_stack([translation[:, 2], -translation[:, 0]])).rounded(1.5)


def streets_under(drive: Path, merge_m: float = 9.0) -> list[Path]:
    """The streets below a recorded drive: passes over ground that was already driven add no second street."""
    dense = drive.sampled(1.0).points
    repeated = _repeats_earlier(dense, merge_m)
    starts = np.flatnonzero(~repeated & np.concatenate([[True], repeated[:-1]]))
    ends = np.flatnonzero(~repeated & np.concatenate([repeated[1:], [True]]))
    pieces = [dense[max(0, start - 12) : end + 13] for start, end in zip(starts, ends, strict=True) if end - start > 15]
    return [Path.through(piece) for piece in pieces]


def _repeats_earlier(dense: Floats, merge_m: float) -> NDArray[np.bool_]:
    neighbours = cKDTree(dense).query_ball_point(dense, merge_m)
    gap = int(4 * merge_m)
    return np.array([min(near) < index - gap for index, near in enumerate(neighbours)])
