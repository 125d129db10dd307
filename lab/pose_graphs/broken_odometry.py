"""Two robots on one road, loops at every submap, and an odometry of the second that goes wrong. Simulated.

Each fault is of the size that users have: a slip, a jump, a turn, a scale, a slope, a heading. Asked is how far the
second drive ends up beside the first one, how many of the right loops are kept, and what is named.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.faults import OdometryFault
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import optimise

SUBMAPS, STEP_M, AT = 60, 5.0, 30
LOOP_COVARIANCE = np.diag([0.05**2] * 3 + [0.003**2] * 3)

Motion = Callable[[int, se3.Matrix4], se3.Matrix4]
"""The motion to a submap as odometry has it, by its number and the true one."""


def _at_once(*tangent: float) -> Motion:
    change = se3.exp(tangent)
    return lambda number, motion: motion @ change if number == AT else motion


def _throughout(scale: float = 0.0, slope: float = 0.0, heading_deg: float = 0.0) -> Motion:
    def motion_of(_: int, motion: se3.Matrix4) -> se3.Matrix4:
        moved = motion.copy()
        moved[:3, 3] *= 1.0 + scale
        moved[2, 3] += slope * STEP_M
        return np.asarray(moved @ se3.from_yaw(math.radians(heading_deg) * STEP_M))

    return motion_of


FAULTS: dict[str, Motion] = {
    "none": _throughout(),
    "slip of 2 m": _at_once(-2, 0, 0, 0, 0, 0),
    "slip of 5 m": _at_once(-5, 0, 0, 0, 0, 0),
    "jump of 10 m": _at_once(3, 10, 0, 0, 0, 0),
    "turn of 20 degrees": _at_once(0, 0, 0, 0, 0, math.radians(20)),
    "tilt of 6 degrees": _at_once(0, 0, 0, 0, math.radians(6), 0),
    "scale 1.05": _throughout(scale=0.05),
    "scale 1.08": _throughout(scale=0.08),
    "slope 5 %": _throughout(slope=0.05),
    "heading 0.1 degrees/m": _throughout(heading_deg=0.1),
}


@dataclass(frozen=True)
class Outcome:
    """Loops kept and given, the worst distance of the second drive from the first, metres, and the faults named."""

    fault: str
    hole_m: float
    kept: int
    loops: int
    worst_m: float
    named: tuple[OdometryFault, ...]


def run(holes_m: Sequence[float] = (0.0, 20.0), seed: int = 1) -> Iterator[Outcome]:
    """Every fault, with loops all along, and with none so far around the submap at which it happens."""
    for (name, wrong), hole_m in itertools.product(FAULTS.items(), holes_m):
        yield _measured(name, wrong, hole_m, seed)


def _measured(name: str, wrong: Motion, hole_m: float, seed: int) -> Outcome:
    rng = np.random.default_rng(seed)
    way = _way()
    drives = [_driven("a", way, _throughout(), rng), _driven("b", way, wrong, rng)]
    heard = [k for k in range(SUBMAPS) if not hole_m or abs(k - AT + 0.5) * STEP_M > 0.5 * hole_m]
    noise = rng.normal(size=(SUBMAPS, 6)) * np.sqrt(np.diag(LOOP_COVARIANCE))
    loops = [LoopEdge(f"{k}", Node("a", k), Node("b", k), se3.exp(noise[k]), LOOP_COVARIANCE) for k in heard]
    found = optimise(PoseGraph.of(drives, loops))
    gaps = np.linalg.inv(found.T_map_submap["a"]) @ found.T_map_submap["b"]
    kept = sum(state is GraphState.IN_MAP for state in found.loops)
    worst_m = float(np.linalg.norm(gaps[:, :3, 3], axis=1).max())
    return Outcome(name, hole_m, kept, len(loops), worst_m, found.faults)


def _way() -> NDArray[np.float64]:
    """T_world_submap (n, 4, 4) along a road with bends."""
    turns = [se3.from_yaw(0.06 * math.sin(k / 9.0), (STEP_M, 0.0, 0.0)) for k in range(SUBMAPS - 1)]
    return np.stack(list(itertools.accumulate(turns, np.matmul, initial=np.eye(4))))


def _driven(session: str, way: NDArray[np.float64], wrong: Motion, rng: np.random.Generator) -> Trajectory:
    """A drive whose odometry drifts by 1 % of noise, and as `wrong` says."""
    poses = [se3.from_yaw(rng.uniform(-3, 3), rng.uniform(-100, 100, 3))]
    for number, (first, second) in enumerate(itertools.pairwise(way), 1):
        noise = rng.normal(0.0, [0.03, 0.03, 0.02, 1e-3, 1e-3, 3e-3])
        poses.append(poses[-1] @ wrong(number, se3.inverse(first) @ second) @ se3.exp(noise))
    return Trajectory.from_odometry(session, np.stack(poses))


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes in Markdown, a row each."""
    head = "| odometry | loops missing around it | kept | worst | named |\n|---|---|---|---|---|\n"
    return head + "\n".join(_row(one) for one in outcomes)


def _row(one: Outcome) -> str:
    named = ", ".join(f"{f.session}: {f.kind} {abs(f.amount):.3g}, submaps {f.first} to {f.last}" for f in one.named)
    return f"| {one.fault} | {one.hole_m:.0f} m | {one.kept} of {one.loops} | {one.worst_m:.2f} m | {named or '-'} |"
