"""The place and the heading of a level map in the world by its anchors, and anchors as terms of least squares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.absolute_edges import AbsoluteEdges
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import Node

Array64 = NDArray[np.float64]

LEAST_SIGMA_M = 0.01
"""No place is surer."""

TILT_SIGMA_RAD = np.radians(1.0)
"""How level the frame of a map is: that of the first pose of its odometry."""

_ROUNDS = 30
"""Of the alignment with weights; it moves by less than a millimetre then."""


def absolute_edges(anchors: Sequence[Anchor], rows: Mapping[Node, int]) -> AbsoluteEdges:
    """The anchors as terms of least squares. Those of one submap count as one together: their errors are alike."""
    beside = Counter(one.node for one in anchors)
    information = np.zeros((len(anchors), 6, 6))
    forwards, headings = np.tile([1.0, 0.0, 0.0], (len(anchors), 1)), np.zeros(len(anchors))
    for n, one in enumerate(anchors):
        share = 1.0 / beside[one.node]
        information[n, :3, :3] = share * np.linalg.inv(one.covariance + LEAST_SIGMA_M**2 * np.eye(3))
        if one.heading is not None:
            forwards[n], headings[n] = one.heading.forward_submap, one.heading.angle_rad
            information[n, 5, 5] = share / one.heading.sigma_rad**2
    return AbsoluteEdges(
        np.array([rows[one.node] for one in anchors], dtype=np.int64),
        np.reshape([one.point_submap for one in anchors], (-1, 3)),
        np.reshape([one.place_world for one in anchors], (-1, 3)),
        np.tile([0.0, 0.0, 1.0], (len(anchors), 1)),
        forwards,
        headings,
        information,
    )


def level(row: int, T_map_submap: se3.Matrix4) -> AbsoluteEdges:
    """The term that keeps a map level whose pose in `row` is `T_map_submap`: it says nothing of place and heading."""
    information = np.zeros((1, 6, 6))
    information[0, 3, 3] = information[0, 4, 4] = TILT_SIGMA_RAD**-2.0
    return AbsoluteEdges(
        np.array([row]), np.zeros((1, 3)), np.zeros((1, 3)), T_map_submap[None, 2, :3], np.eye(3)[:1], np.zeros(1),
        information,
    )  # fmt: skip


def aligned(edges: AbsoluteEdges, T_map_submap: Array64) -> se3.Matrix4:
    """T_world_map (4, 4), level, by which the anchors fit best to poses (n, 4, 4), roughly: wrong ones pull little.

    By Cauchy weights, whose scale is the median of the misfits: a drive that drifts fits nowhere as well as it states.
    """
    stated = edges.information[:, 0, 0] + edges.information[:, 1, 1]
    points, T_world_map = edges.points_at(T_map_submap), _level_fit(edges, T_map_submap, stated)
    for _ in range(_ROUNDS):
        misfits = np.linalg.norm(se3.apply(T_world_map, points) - edges.places, axis=1)
        scale = max(float(np.median(misfits)), LEAST_SIGMA_M)
        T_world_map = _level_fit(edges, T_map_submap, stated / (1.0 + (misfits / scale) ** 2))
    return T_world_map


def _level_fit(edges: AbsoluteEdges, T_map_submap: Array64, weights: Array64) -> se3.Matrix4:
    """The turn about z and the translation (4, 4) that take the points nearest to their places, with weights (k,), and
    the directions to their headings.
    """
    share, points, places = weights / weights.sum(), edges.points_at(T_map_submap), edges.places
    middle, target = share @ points, share @ places
    a, b = (points - middle)[:, :2], (places - target)[:, :2]
    turns, told = edges.headings - edges.headings_at(T_map_submap), 2.0 * edges.information[:, 5, 5] / weights.sum()
    cosine = share @ (a * b).sum(axis=1) + told @ np.cos(turns)
    sine = share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) + told @ np.sin(turns)
    return _turned(float(np.arctan2(sine, cosine)), middle, target)


def _turned(angle: float, middle: Array64, target: Array64) -> se3.Matrix4:
    """The turn by an angle about z that takes point `middle` to `target`."""
    return se3.from_yaw(angle, target - se3.from_yaw(angle)[:3, :3] @ middle)


def heading_sigma_rad(edges: AbsoluteEdges, T_world_submap: Array64) -> float:
    """How sure the heading of a stiff map is by the spread of its anchors; infinite where they do not tell it."""
    offsets = edges.points_at(T_world_submap)
    turned = np.stack([-offsets[:, 1], offsets[:, 0], np.zeros(len(offsets))], axis=1)
    jacobians = np.concatenate([np.tile(np.eye(3), (len(offsets), 1, 1)), turned[:, :, None]], axis=2)
    of_places = edges.information[:, :3, :3]
    known = np.einsum("kia,kij,kjb->ab", jacobians, of_places, jacobians)
    known[3, 3] += edges.information[:, 5, 5].sum()
    schur = known[3, 3] - known[3, :3] @ np.linalg.solve(known[:3, :3], known[:3, 3])
    return float(schur**-0.5) if schur > 0.0 else np.inf
