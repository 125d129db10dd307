"""A recording cut into submaps, by its poses alone: points are read when a submap is built."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud, MalformedBody, RevisitError
from revisit.core.scan import CloudReport, Scan
from revisit.core.submap import Submap, SubmapBuilder, described_scans
from revisit.evaluation.datasets import Recording
from revisit.evaluation.perturbations import Perturbation

Window = tuple[int, ...]


def cut(recording: Recording, config: SubmapConfig, scans: Sequence[int] | None = None) -> list[Window]:
    """The scan indices of every submap, in order; `scans` restricts and orders the scans that are used.

    Scans of a robot that stands still are left out; of the others `load_submap` chooses by their returns.
    """
    builder = SubmapBuilder(config)
    windows: list[list[Scan] | None] = []
    for index in range(len(recording)) if scans is None else scans:
        windows.append(builder.add(_stand_in(recording, index)))
    windows.append(builder.flush())
    return [tuple(scan.stamp_ns for scan in window) for window in windows if window is not None]


def _stand_in(recording: Recording, index: int) -> Scan:
    """A scan without points whose stamp is its index: the builder looks at poses only."""
    return Scan(np.zeros((0, 3), dtype=np.float32), recording.pose(index), index, CloudReport(0, False))


def load_submap(
    recording: Recording, window: Window, config: SubmapConfig, perturbation: Perturbation
) -> tuple[Submap, Window]:
    """The submap of a window, thinned but not turned, and the scans in it: a bad scan is left out.

    Raises the error of the last scan where all are bad, EmptyCloud where too few points remain.
    """
    scans: list[Scan] = []
    used: dict[int, int] = {}
    problem: RevisitError = EmptyCloud("the window holds no scan")
    for index in window:
        try:
            scan = recording.scan(index)
        except (RevisitError, OSError) as error:
            problem = error if isinstance(error, RevisitError) else MalformedBody(f"scan {index} cannot be read")
            continue
        # a thinned scan may have very few points: only the submap must have enough
        scans.append(dataclasses.replace(scan, points=perturbation.thin(scan.points, index), columns={}))
        used[id(scans[-1])] = index
    if not scans:
        raise problem
    chosen = described_scans(scans, config)
    return Submap.from_scans(chosen, config), tuple(used[id(scan)] for scan in chosen)
