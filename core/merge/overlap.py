"""Agreement of the surfaces of two placed groups of submaps, beyond the loops that placed them.

Wrong loops that agree with each other look like right ones to any optimiser of poses. The surfaces know better: where
two groups truly overlap, the points of one lie on the surfaces of the other, and none of them stands where the other
looked through.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.geometry import se3
from revisit.core.implicit_map.visibility import count_seen_through
from revisit.core.merge.fused import PlacedMap

Array = NDArray[np.float32]


class MergeRefusal(StrEnum):
    """Why two groups are not joined."""

    TOO_FEW_LOOPS = "TOO_FEW_LOOPS"
    COMMON_TRACK_TOO_SHORT = "COMMON_TRACK_TOO_SHORT"
    ALIGNMENTS_COMPETE = "ALIGNMENTS_COMPETE"
    OVERLAP_TOO_SMALL = "OVERLAP_TOO_SMALL"
    SURFACES_DISAGREE = "SURFACES_DISAGREE"
    FREE_SPACE_VIOLATED = "FREE_SPACE_VIOLATED"


@dataclass(frozen=True)
class MergeLimits:
    """Thresholds of the evidence. Lengths in metres.

    loops that agree; the way that they span; rival_share, how many loops a competing alignment may have compared with
    the chosen one; the common points; the median distance of common points from the other's surface; the share of
    points that may stand where the other looked through.
    """

    loops: int = 3
    common_track_m: float = 10.0
    rival_share: float = 0.25
    common_points: int = 1_000
    median_residual_m: float = 0.15
    seen_through_share: float = 0.054

    def scaled(self, scale: float) -> MergeLimits:
        """The limits of a scene of another size: lengths times `scale`."""
        return replace(
            self, common_track_m=self.common_track_m * scale, median_residual_m=self.median_residual_m * scale
        )


@dataclass(frozen=True)
class MergeEvidence:
    """The evidence for joining two placed groups.

    common_points lie within a resolution of the other group's; residual_m is the median and far_share the share beyond
    half a resolution of their distance from its surface; seen_through_share is the larger of both directions' shares of
    points, among those near the other's submaps, that it looked through; overlap_share is that of common points among
    the points of the submaps that were compared.
    """

    common_points: int
    residual_m: float
    far_share: float
    seen_through_share: float
    overlap_share: float = 0.0


def compare_surfaces(first: Sequence[PlacedMap], second: Sequence[PlacedMap]) -> MergeEvidence:
    """The points of each group against the field and the free space of the other, every submap with every other."""
    return compare_pairs((one, other) for one in first for other in second)


def compare_pairs(pairs: Iterable[tuple[PlacedMap, PlacedMap]]) -> MergeEvidence:
    """The points of each submap of a pair against the field and the free space of the other one.

    Everything rests on neural points: rays are those from the middle of a submap to its points.
    """
    residuals: list[NDArray[np.floating]] = [np.zeros(0)]
    far, points = [0], 0
    checked, through = [0, 0], [0, 0]
    for pair in pairs:
        for direction, (one, other) in enumerate((pair, pair[::-1])):
            positions = seen_from(one, other)
            values, nearest = other.neural_map.sdf(positions)
            resolution, scale = other.neural_map.config.resolution, other.neural_map.frame.scale
            common = np.abs(values[nearest < resolution])
            residuals.append(common * scale)
            far.append(int((common > 0.5 * resolution).sum()))
            points += len(positions)
            seen = _within_view(positions, other)
            checked[direction] += int(seen.sum())
            through[direction] += int(looked_through(positions[seen], other).sum())
    distances = np.concatenate(residuals)
    return MergeEvidence(
        len(distances),
        float(np.median(distances)) if len(distances) else float("inf"),
        sum(far) / len(distances) if len(distances) else 1.0,
        max(part / whole if whole else 0.0 for part, whole in zip(through, checked, strict=True)),
        len(distances) / points if points else 0.0,
    )


def pairs_in_reach(
    first: NDArray[np.float64], second: NDArray[np.float64], reach_m: float, nearest: int = 2, most: int = 200
) -> list[tuple[int, int]]:
    """Which submaps at positions (n, 3) and (m, 3) to compare: of each the `nearest` of the other group within reach.

    Of more than `most` pairs, so many that are spread evenly over all.
    """
    pairs = set[tuple[int, int]]()
    for swapped, (ours, theirs) in enumerate(((first, second), (second, first))):
        gaps, rows = cKDTree(theirs).query(ours, k=min(nearest, len(theirs)), distance_upper_bound=reach_m)
        gaps, rows = gaps.reshape(len(ours), -1), rows.reshape(len(ours), -1)
        for one, place in np.argwhere(np.isfinite(gaps)).tolist():
            other = int(rows[one, place])
            pairs.add((other, one) if swapped else (one, other))
    ordered = sorted(pairs)
    chosen = np.unique(np.linspace(0, len(ordered) - 1, most).round().astype(int)) if len(ordered) > most else None
    return ordered if chosen is None else [ordered[row] for row in chosen]


def loops_refusal(
    loops: int, common_track_m: float, rival_loops: int, limits: MergeLimits = MergeLimits()
) -> MergeRefusal | None:
    """The first reason that the loops give against joining, None where there is none.

    `loops` agree with the alignment and span `common_track_m`; `rival_loops` agree with another one.
    """
    reasons = (
        (loops < limits.loops and rival_loops < limits.loops, MergeRefusal.TOO_FEW_LOOPS),
        (rival_loops >= limits.rival_share * loops and rival_loops > 1, MergeRefusal.ALIGNMENTS_COMPETE),
        (loops < limits.loops, MergeRefusal.TOO_FEW_LOOPS),
        (common_track_m < limits.common_track_m, MergeRefusal.COMMON_TRACK_TOO_SHORT),
    )
    return next((reason for holds, reason in reasons if holds), None)


def refusal(
    evidence: MergeEvidence,
    loops: int,
    common_track_m: float,
    rival_loops: int = 0,
    limits: MergeLimits = MergeLimits(),
) -> MergeRefusal | None:
    """The first reason against joining, of the loops or of the surfaces, None where there is none."""
    return loops_refusal(loops, common_track_m, rival_loops, limits) or surfaces_refusal(evidence, limits)


def surfaces_refusal(evidence: MergeEvidence, limits: MergeLimits = MergeLimits()) -> MergeRefusal | None:
    """The first reason that the surfaces give against joining, None where there is none."""
    reasons = (
        (evidence.common_points < limits.common_points, MergeRefusal.OVERLAP_TOO_SMALL),
        (evidence.residual_m > limits.median_residual_m, MergeRefusal.SURFACES_DISAGREE),
        (evidence.seen_through_share > limits.seen_through_share, MergeRefusal.FREE_SPACE_VIOLATED),
    )
    return next((reason for holds, reason in reasons if holds), None)


def seen_from(one: PlacedMap, other: PlacedMap) -> Array:
    """The points (n, 3) of a map in the level frame of another one."""
    in_map = one.neural_map.frame.points_to_submap(one.neural_map.points.positions)
    T_other_one = se3.inverse(other.T_map_submap) @ one.T_map_submap
    in_other = in_map @ T_other_one[:3, :3].T + T_other_one[:3, 3]
    frame = other.neural_map.frame
    return np.asarray((in_other - frame.translation) @ frame.rotation / frame.scale, dtype=np.float32)


def _within_view(positions: Array, other: PlacedMap) -> NDArray[np.bool_]:
    """Which positions (n, 3) are no farther from the middle of a map than half of its points: dense there."""
    reach = np.median(np.linalg.norm(other.neural_map.points.positions, axis=1))
    return np.asarray(np.linalg.norm(positions, axis=1) < reach)


def looked_through(positions: Array, other: PlacedMap) -> NDArray[np.bool_]:
    """Which positions (n, 3) lie before the points of a map in their direction, seen from its middle."""
    points, middle = other.neural_map.points.positions, np.zeros((1, 3), np.float32)
    index = np.zeros(len(points), np.int32)
    return np.asarray(count_seen_through(np.ascontiguousarray(positions), points, index, middle) > 0)
