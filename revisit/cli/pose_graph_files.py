"""Submap poses and loop closures in files that other tools read: g2o, TUM and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.sdk.resources import LoopClosure, Submap

ODOMETRY_INFORMATION = np.diag([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Assumed, as odometry comes without covariance: 0.1 m and 1.8 degrees between two submaps."""


@dataclass(frozen=True)
class Graph:
    """Submaps by session in their order, and the accepted loops between them."""

    tracks: list[list[Submap]]
    loops: list[LoopClosure]


def as_g2o(graph: Graph) -> str:
    """SE(3) vertices of all submaps, odometry edges within sessions, loop edges. Sessions keep their own frames."""
    number = {submap.name: index for index, submap in enumerate(s for track in graph.tracks for s in track)}
    lines = [f"VERTEX_SE3:QUAT {number[s.name]} {_numbers(s.T_odom_submap)}" for track in graph.tracks for s in track]
    for track in graph.tracks:
        for first, second in pairwise(track):
            T_first_second = se3.inverse(first.T_odom_submap) @ second.T_odom_submap
            lines.append(_edge(number[first.name], number[second.name], T_first_second, ODOMETRY_INFORMATION))
    for loop in graph.loops:
        if loop.T_match_query is not None and {loop.match, loop.query} <= number.keys():
            lines.append(_edge(number[loop.match], number[loop.query], loop.T_match_query, _information(loop)))
    return "\n".join(lines) + "\n"


def as_tum(graph: Graph) -> str:
    """`stamp x y z qx qy qz qw`, stamp in seconds."""
    lines = [
        f"{submap.stamp_ns // 10**9}.{submap.stamp_ns % 10**9:09d} {_numbers(submap.T_odom_submap)}"
        for track in graph.tracks
        for submap in track
    ]
    return "\n".join(lines) + "\n"


def as_csv(graph: Graph) -> str:
    """One row a loop: query, match, similarity, score and T_match_query."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["query", "match", "similarity", "score", "x", "y", "z", "qx", "qy", "qz", "qw"])
    for loop in graph.loops:
        pose = [] if loop.T_match_query is None else _numbers(loop.T_match_query).split()
        writer.writerow([loop.query, loop.match, loop.similarity, loop.score, *pose])
    return buffer.getvalue()


def _edge(first: int, second: int, T_first_second: Matrix4, information: np.ndarray) -> str:
    upper = " ".join(f"{value:.9g}" for value in information[np.triu_indices(6)])
    return f"EDGE_SE3:QUAT {first} {second} {_numbers(T_first_second)} {upper}"


def _information(loop: LoopClosure) -> np.ndarray:
    """The inverse of the loop's covariance (x, y, z, rx, ry, rz) where it came with one, else as for odometry.

    The service states it in the match frame; a g2o edge wants it in the frame that the edge leads to, the query's.
    """
    measured = np.asarray(loop.evidence.get("measurement", {}).get("covariance", []), dtype=np.float64)
    if measured.size != 36 or not np.isfinite(measured).all() or loop.T_match_query is None:
        return ODOMETRY_INFORMATION
    turn = se3.adjoint(se3.inverse(loop.T_match_query))
    return np.linalg.pinv(turn @ measured.reshape(6, 6) @ turn.T, hermitian=True)


def _numbers(transform: Matrix4) -> str:
    values = [*transform[:3, 3], *se3.to_quaternion(transform)]
    return " ".join(f"{value:.9f}" for value in values)
