"""Units, times, motion and points, checked by the numbers alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.sanity.finding import Finding
from revisit.core.scan import MAX_SCENE_M, Scan, spread_pieces

Array = NDArray[np.float64]
Poses = NDArray[np.float64]
Stamps = NDArray[np.int64]

MIN_SCENE_M = 1.0
MAX_SPEED_M_PER_S = 70.0
MIN_PERIOD_NS = 2_000_000
EPOCH_NS = 10**16
"""Times above are nanoseconds, of 1970 or later: in microseconds they would lie in the year 2286."""
MIN_POINTS_A_SCAN = 1_000
MAX_NON_FINITE = 0.4


def check_units(sizes_m: Sequence[float]) -> list[Finding]:
    """Whether scenes of such sizes (`scene_size`) are in metres."""
    if not sizes_m:
        return []
    size = float(np.median(sizes_m))
    measured = f"95 % of the points lie within {size:.3g} m"
    if size > MAX_SCENE_M:
        unit, factor = ("millimetres", 0.001) if size > 8_000.0 else ("centimetres", 0.01)
        return [Finding("scene_too_large", measured, f"the points are in {unit}", f"multiply them by {factor}")]
    if size < MIN_SCENE_M:
        return [Finding("scene_too_small", measured, "the points are scaled, or in kilometres", "give metres")]
    return []


def check_times(stamps_ns: Stamps) -> list[Finding]:
    """Whether the times (n,) rise, and by as much as a LiDAR takes for a scan."""
    if len(stamps_ns) < 3:
        return []
    steps = np.diff(stamps_ns)
    period = float(np.median(steps))
    found = []
    twice = period == 0 and stamps_ns.min() > EPOCH_NS  # whole seconds, too, are mostly 0 apart
    if 0 <= period < MIN_PERIOD_NS and not twice:
        unit = "seconds" if period < 20 else "milliseconds" if period < 20_000 else "microseconds"
        cause, advice = f"the times are in {unit}", "give nanoseconds (stamp_ns)"
        found.append(Finding("time_unit", f"scans are {period:g} ns apart", cause, advice))
    elif (steps <= 0).any():
        measured = f"{int((steps <= 0).sum())} of {len(steps)} scans are no later than the one before"
        if twice:
            cause, advice = "the scans are there twice", "send each scan once"
        else:
            cause, advice = "the clock was set, or two recordings are joined", "one session for each run of the clock"
        found.append(Finding("time_goes_back", measured, cause, advice))
    return found


def check_motion(poses: Poses, stamps_ns: Stamps) -> list[Finding]:
    """Whether poses (n, 4, 4) move as a robot does: no jumps, and no speed above 250 km/h."""
    if len(poses) < 3:
        return []
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    typical = float(np.median(steps))
    jumps = np.flatnonzero(steps > max(15.0, 20.0 * typical))
    found = []
    if len(jumps):
        where = f"the largest {steps.max():.0f} m behind scan {steps.argmax()}"
        measured = f"{len(jumps)} of {len(steps)} steps are jumps, {where}"
        cause = "GNSS fixes, a map frame that is corrected, or two recordings in one"
        found.append(Finding("pose_jump", measured, cause, "give smooth odometry, or one session for each part"))
    seconds = float(np.median(np.diff(stamps_ns))) / 1e9
    if seconds >= MIN_PERIOD_NS / 1e9 and typical / seconds > MAX_SPEED_M_PER_S:
        measured = f"the sensor moves at {typical / seconds:.0f} m/s"
        found.append(Finding("too_fast", measured, "the poses are no metres, or the times no nanoseconds", "give both"))
    return found


def check_points(scans: Sequence[Scan]) -> list[Finding]:
    """Whether the scans have enough points, few of them missing, and rows that are read as they were written."""
    found = []
    counts = [len(scan.points) for scan in scans]
    missing = [scan.report.dropped_nonfinite / (scan.report.dropped_nonfinite + len(scan.points)) for scan in scans]
    if np.median(counts) < MIN_POINTS_A_SCAN:
        measured = f"{int(np.median(counts))} points a scan"
        cause = "packets of a sweep instead of sweeps, or thinned clouds"
        found.append(Finding("sparse", measured, cause, "send whole sweeps with all their points"))
    if np.median(missing) > MAX_NON_FINITE:
        measured = f"{100 * np.median(missing):.0f} % of the points are NaN or infinite"
        cause = "an organised cloud of an open place, or a damaged field"
        found.append(Finding("non_finite", measured, cause, "leave them out; see whether the fields are right"))
    at_origin = np.median([(np.abs(_rows(scan)) < 0.01).all(axis=1).mean() for scan in scans])
    if at_origin > 0.3:
        measured = f"{100 * at_origin:.0f} % of the points are at the sensor's origin"
        found.append(Finding("zeros", measured, "returns that did not come back are stored as zeros", "leave them out"))
    columns = [_columns(scan) for scan in scans]
    if scans and columns.count(4) < len(columns) / 2:
        likely = 3 if columns.count(3) >= columns.count(5) else 5
        measured = f"every {likely}rd row differs from the others" if likely == 3 else "every 5th row differs"
        cause = f"rows of {likely} numbers are read as rows of 4"
        found.append(Finding("columns", measured, cause, "write float32 x, y, z, reflectance, or .npy, .ply or .pcd"))
    return found


def _columns(scan: Scan) -> int:
    """How many numbers a row of the source had: rows of 3 or 5 that are read as 4 change their meaning periodically."""
    points = _rows(scan)
    for period in (3, 5):
        rows = [points[start::period] for start in range(period)]
        there = [part[(part != 0.0).any(axis=1)] for part in rows]
        if min(len(part) for part in there) == 0:
            continue
        spread = np.array([np.median(np.abs(part), axis=0) for part in there])
        if (spread.max(axis=0) > 3.0 * np.maximum(spread.min(axis=0), 1e-6)).sum() >= 2:
            return period
    return 4


def _rows(scan: Scan) -> NDArray[np.floating]:
    return spread_pieces(scan.points, _MOST_ROWS)


_MOST_ROWS = 30_000
