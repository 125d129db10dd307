"""The truth of the demo's submaps, and the found loops beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3


@dataclass(frozen=True)
class TrueSubmap:
    """A submap with the truth the simulator knows.

    order counts submaps of all robots as they were driven; position (3,) the mean of its scans; T_world_submap the pose
    of its middle scan.
    """

    name: str
    robot: str
    order: int
    position: NDArray[np.float64]
    T_world_submap: se3.Matrix4


@dataclass(frozen=True)
class FoundLoop:
    """A loop closure the service accepted."""

    query: str
    match: str
    T_match_query: se3.Matrix4


@dataclass(frozen=True)
class Targets:
    """The targets of the demo.

    A revisit is a submap within `revisit_m` of an earlier one, more than `gap` submaps before it or of another robot; a
    loop is false where its pose is off by more than `false_m` or `false_deg`.
    """

    revisit_m: float = 10.0
    gap: int = 10
    found: float = 0.95
    median_m: float = 0.3
    median_deg: float = 0.5
    false_m: float = 2.0
    false_deg: float = 5.0


@dataclass(frozen=True)
class JudgedLoop:
    """A found loop with the error of its pose and how far apart the two submaps truly are."""

    loop: FoundLoop
    error_m: float
    error_deg: float
    distance_m: float
    false: bool


@dataclass(frozen=True)
class LoopReport:
    """The demo's figures."""

    revisits: int
    revisits_found: int
    missed: tuple[str, ...]
    loops: tuple[JudgedLoop, ...]
    targets: Targets

    @property
    def found_share(self) -> float:
        """Share of the true revisits that an accepted, true loop names."""
        return self.revisits_found / self.revisits if self.revisits else 0.0

    @property
    def false_loops(self) -> int:
        """Accepted loops that are not true."""
        return sum(judged.false for judged in self.loops)

    @property
    def median_m(self) -> float:
        """Median position error of the accepted loops, metres; infinite without loops."""
        return float(np.median([judged.error_m for judged in self.loops])) if self.loops else float("inf")

    @property
    def median_deg(self) -> float:
        """Median rotation error of the accepted loops, degrees; infinite without loops."""
        return float(np.median([judged.error_deg for judged in self.loops])) if self.loops else float("inf")

    @property
    def reached(self) -> bool:
        """Whether every target is met."""
        return (
            self.revisits > 0
            and self.found_share >= self.targets.found
            and self.false_loops == 0
            and self.median_m <= self.targets.median_m
            and self.median_deg <= self.targets.median_deg
        )


def compare(submaps: Mapping[str, TrueSubmap], loops: Sequence[FoundLoop], targets: Targets) -> LoopReport:
    """Judge every loop by its pose, then ask of every true revisit whether a true loop leads back to an earlier pass.

    Raises KeyError for a loop of an unknown submap.
    """
    judged = tuple(_judge(submaps[loop.query], submaps[loop.match], loop, targets) for loop in loops)
    links = {frozenset((item.loop.query, item.loop.match)) for item in judged if not item.false}
    ordered = sorted(submaps.values(), key=lambda submap: submap.order)
    revisits = [(later, _earlier_passes(later, ordered, targets)) for later in ordered]
    revisits = [(later, passes) for later, passes in revisits if any(near for _, near in passes)]
    missed = tuple(
        later.name for later, passes in revisits if not any({later.name, p.name} in links for p, _ in passes)
    )
    return LoopReport(len(revisits), len(revisits) - len(missed), missed, judged, targets)


def _judge(query: TrueSubmap, match: TrueSubmap, loop: FoundLoop, targets: Targets) -> JudgedLoop:
    error = se3.inverse(loop.T_match_query) @ se3.inverse(match.T_world_submap) @ query.T_world_submap
    metres, degrees = float(np.linalg.norm(error[:3, 3])), float(np.degrees(se3.rotation_angle(error)))
    distance = float(np.linalg.norm(query.position - match.position))
    return JudgedLoop(loop, metres, degrees, distance, metres > targets.false_m or degrees > targets.false_deg)


def _earlier_passes(
    later: TrueSubmap, ordered: Sequence[TrueSubmap], targets: Targets
) -> list[tuple[TrueSubmap, bool]]:
    """The submaps of earlier passes, and whether each lies within the revisit distance."""
    return [
        (earlier, bool(np.linalg.norm(earlier.position - later.position) <= targets.revisit_m))
        for earlier in ordered
        if earlier.order < later.order and (earlier.robot != later.robot or later.order - earlier.order > targets.gap)
    ]
