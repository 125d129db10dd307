"""Stretches that are taken for others beside right loops: whether they turn off what guards a map.

Two guards look at all loops together: by how much a heading turns (`core.pose_graph.heading_bias`), and whether a graph
states its uncertainties far too large (`core.pose_graph.variance_factor`). Neighbours that agree are one mistake.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.pose_graphs.benchmark import rms_distance
from lab.pose_graphs.g2o_reading import read_g2o
from lab.pose_graphs.wrong_loops import is_wrong, with_aliases
from revisit.core.geometry import se3_rows
from revisit.core.pose_graph.faults import composed, steps_of
from revisit.core.pose_graph.graph import GraphState, PoseGraph, Trajectory
from revisit.core.pose_graph.heading_bias import heading_bias
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.core.pose_graph.support import loops_within
from revisit.core.pose_graph.variance_factor import variance_factor

SEEDS = 3


@dataclass(frozen=True)
class Case:
    """A graph of which `loops` remain (None: all), a heading that is turned by so many degrees a metre more than it was
    recorded, and stretches of `length` submaps that are taken for others.
    """

    graph: str
    loops: int | None
    turned_deg_m: float
    stretches: int
    length: int


@dataclass(frozen=True)
class Outcome:
    """The worst of all seeds: the bias found, degrees a metre, and the factor of uncertainties; loops kept; root mean
    square distance from the plain optimum of the right loops with the odometry as recorded, metres.
    """

    case: Case
    bias_deg_m: float
    factor: float
    right: int
    right_kept: int
    wrong_kept: int
    distance_m: float


CASES = tuple(
    Case(graph, loops, turned_deg_m, stretches, length)
    for graph, loops, turned_deg_m, length in (
        ("kitti_05", 43, 0.02, 18),
        ("kitti_00", None, 0.02, 18),
        ("CSAIL", 20, 0.0, 9),
        ("intel", 20, 0.0, 9),
        ("kitti_05", 20, 0.0, 9),
        ("sphere2500", 20, 0.0, 9),
        ("parking-garage", 20, 0.0, 9),
    )
    for stretches in ((0, 1, 3, 5) if turned_deg_m else (0, 1, 3))
)


def run(folder: Path, cases: Sequence[Case] = CASES, seeds: int = SEEDS) -> Iterator[Outcome]:
    """Each case with the graphs of a folder."""
    return (outcome(folder, case, seeds) for case in cases)


def outcome(folder: Path, case: Case, seeds: int = SEEDS) -> Outcome:
    """A commit of a case, the worst of some seeds."""
    recorded = _thinned(read_g2o((folder / f"{case.graph}.g2o").read_text()), case.loops)
    best = optimise(recorded, Robustness.PLAIN).T_map_submap
    graph = replace(recorded, trajectories=tuple(_turned(one, case.turned_deg_m) for one in recorded.trajectories))
    ones = [_commit(graph, case, seed, best) for seed in range(seeds if case.stretches else 1)]
    return Outcome(
        case,
        min((one.bias_deg_m for one in ones), key=abs),
        min(one.factor for one in ones),
        len(graph.loops),
        min(one.right_kept for one in ones),
        max(one.wrong_kept for one in ones),
        max(one.distance_m for one in ones),
    )


def _commit(graph: PoseGraph, case: Case, seed: int, best: dict[str, NDArray[np.float64]]) -> Outcome:
    """The outcome of one seed; `best` are the poses (n, 4, 4) that the map should have."""
    spoilt = with_aliases(graph, case.stretches * case.length, seed, case.length)
    result = optimise(spoilt, Robustness.COMMIT)
    kept = [loop for loop, state in zip(spoilt.loops, result.loops, strict=True) if state is GraphState.IN_MAP]
    wrong, apart_m = sum(map(is_wrong, kept)), rms_distance(result.T_map_submap, best)
    figures = len(graph.loops), len(kept) - wrong, wrong, apart_m
    return Outcome(case, _bias_deg_m(spoilt), variance_factor(spoilt), *figures)


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes as a table in Markdown."""
    lines = [
        "| graph, right loops | turned by | stretches mistaken | bias found | factor | right, wrong kept | off |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in outcomes:
        case = one.case
        lines.append(
            f"| {case.graph}, {one.right} | {case.turned_deg_m} degrees/m | {case.stretches} of {case.length} "
            f"| {one.bias_deg_m:.3f} degrees/m | {one.factor:.3g} | {one.right_kept}, {one.wrong_kept} "
            f"| {one.distance_m:.2f} m |"
        )
    return "\n".join(lines) + "\n"


def _thinned(graph: PoseGraph, loops: int | None) -> PoseGraph:
    """The graph with so many of its loops, spread over them all."""
    if loops is None:
        return graph
    chosen = np.linspace(0, len(graph.loops) - 1, loops).round().astype(int)
    return PoseGraph.of(list(graph.trajectories), [graph.loops[number] for number in chosen])


def _turned(track: Trajectory, deg_m: float) -> Trajectory:
    """The odometry with its heading turned by so many degrees for each metre."""
    steps = steps_of(track)
    tangents = np.zeros((len(steps), 6))
    tangents[:, 5] = np.radians(deg_m) * np.linalg.norm(steps[:, :3, 3], axis=1)
    return replace(track, T_odom_submap=composed(track.T_odom_submap[0], steps @ se3_rows.exp(tangents)))


def _bias_deg_m(graph: PoseGraph) -> float:
    (track,) = graph.trajectories
    return float(np.degrees(heading_bias(track, loops_within(graph, track)[1])))
