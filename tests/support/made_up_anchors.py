"""Made-up anchors of a made-up fleet: fixes of a receiver on a mast, some of them reflected. Simulated."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import Node
from revisit.core.pose_graph.optimisation import OptimisedGraph
from tests.support.made_up_fleet import Fleet

MAST = np.array([0.3, 0.0, 1.2])
"""The antenna in the frame of a submap, metres."""
JUMP_M = 30.0


def fixes(
    made: Fleet,
    seed: int,
    sigma_m: float,
    wrong_share: float = 0.0,
    street: int = 1,
    sessions: Iterable[str] | None = None,
) -> list[Anchor]:
    """A fix for each submap of a fleet, or of some sessions, less sure of the height; those called `wrong-` are
    reflected, by 30 m into one direction for `street` submaps on end.
    """
    rng, found = np.random.default_rng(seed), []
    for session in made.truth if sessions is None else sessions:
        poses = made.truth[session]
        wrong, angles = np.zeros(len(poses), dtype=bool), rng.uniform(0.0, 2.0 * np.pi, len(poses))
        for first in rng.permutation(len(poses) // street)[: round(wrong_share * len(poses) / street)]:
            wrong[street * first : street * (first + 1)] = True
        for k, T_world_submap in enumerate(poses):
            place = se3.apply(T_world_submap, MAST[None])[0] + sigma_m * rng.normal(size=3) * (1.0, 1.0, 1.5)
            if wrong[k]:
                place[:2] += JUMP_M * np.array([np.cos(angles[k // street]), np.sin(angles[k // street])])
            name = f"{'wrong' if wrong[k] else 'right'}-{session}-{k}"
            found.append(Anchor(name, Node(session, k), MAST, place, sigma_m**2 * np.diag([1.0, 1.0, 2.25])))
    return found


def right(anchors: Collection[Anchor]) -> list[Anchor]:
    """Those that are not reflected."""
    return [one for one in anchors if one.name.startswith("right")]


def error_m(made: Fleet, answer: OptimisedGraph) -> float:
    """Root mean square of the position errors in the world, metres, with no alignment but the answer's own."""
    (found,) = answer.georeferences
    placed = [se3.apply(found.T_world_map, answer.T_map_submap[one][:, :3, 3]) for one in made.truth]
    true = [poses[:, :3, 3] for poses in made.truth.values()]
    return float(np.sqrt(np.mean(np.sum((np.concatenate(placed) - np.concatenate(true)) ** 2, axis=1))))
