"""Errors of the map of a fleet, with and without wrong loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import PoseGraph
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.evaluation.trajectory_error import rigid_fit, trajectory_error

Poses = Mapping[str, se3.Matrix4]


@dataclass(frozen=True)
class FleetOutcome:
    """A map of a fleet with some wrong loops put in, as the service made it.

    `good` loops are those that the service found and that are true, `wrong` all others; ATE in metres: by odometry with
    the starts unknown, of the map, and of a plain optimisation of the good loops alone. `placed` submaps of `submaps`
    are in the largest frame, which is what is measured.
    """

    title: str
    submaps: int
    placed: int
    good: int
    good_kept: int
    wrong: int
    wrong_kept: int
    before_m: float
    after_m: float
    clean_m: float
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the goals are met: 1.1 times the outlier-free graph, 0.5 m, no wrong loop, 95 % of the good ones."""
        near = self.after_m <= min(1.1 * self.clean_m, 0.5) and self.placed == self.submaps
        return near and self.wrong_kept == 0 and self.good_kept >= 0.95 * self.good


def ate_m(estimated: Poses, truth: Poses) -> float:
    """Absolute trajectory error in metres over the poses that are in both. Raises ValueError for fewer than three."""
    return trajectory_error(*_places(estimated, truth))


def aligned(estimated: Poses, truth: Poses) -> dict[str, se3.Matrix4]:
    """The estimated poses, moved by the rigid motion that brings their positions nearest to the true ones."""
    T = rigid_fit(*_places(estimated, truth))
    return {name: np.asarray(T @ pose) for name, pose in estimated.items()}


def _places(estimated: Poses, truth: Poses) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions (n, 3) of the poses that are in both."""
    names = sorted(estimated.keys() & truth.keys())
    places, true_places = (np.array([poses[name][:3, 3] for name in names]) for poses in (estimated, truth))
    return places, true_places


def poses_without_wrong_loops(graph: PoseGraph, wrong: set[str]) -> dict[str, NDArray[np.float64]]:
    """Poses (n, 4, 4) by session of the plain optimum without the loops of these names."""
    clean = replace(graph, loops=tuple(loop for loop in graph.loops if loop.name not in wrong))
    return optimise(clean, Robustness.PLAIN).T_map_submap


def table(outcomes: Sequence[FleetOutcome]) -> str:
    """The outcomes as a table in Markdown."""
    lines = [
        "| wrong loops put in | good kept | wrong kept | ATE before | of the map | of good loops alone | time |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in outcomes:
        kept = f"{one.good_kept} of {one.good} ({100 * one.good_kept / max(one.good, 1):.1f} %)"
        lines.append(
            f"| {one.title} | {kept} | {one.wrong_kept} of {one.wrong} | {one.before_m:.1f} m | {one.after_m:.3f} m "
            f"| {one.clean_m:.3f} m | {one.seconds:.1f} s |"
        )
    return "\n".join(lines) + "\n"
