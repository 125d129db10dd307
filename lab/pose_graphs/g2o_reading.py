"""Pose graphs out of g2o text, SE3:QUAT and SE2: the data sets of the field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from revisit.core.errors import MalformedBody
from revisit.core.geometry import se3
from revisit.core.pose_graph.g2o import HALF_ANGLES, UPPER, Array64
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory

_LARGEST = 1e15
"""No number of an edge is as large: a larger one would overflow where it is squared."""

_UNKNOWN = np.diag([1e8] * 3 + [1e4] * 3)
"""Covariance of a step that no edge states, m^2 and rad^2: it pulls at nothing."""

_OUT_OF_PLANE = 1e-6
"""Variance of z, roll and pitch, which an SE2 edge does not state, m^2 and rad^2."""


def read_g2o(text: str, session: str = "g2o") -> PoseGraph:
    """The edges of a graph as one session: those between successive vertices are its steps, the others are loops.

    A recording of several parts lacks steps: between two vertices without an edge lies what their lines say, and it
    counts as unknown (see `_UNKNOWN`).

    Vertices may have any numbers, in any order: they are taken in ascending order. A step may be written backwards. A
    line that stands twice counts once: the second one measures nothing.
    Raises MalformedBody where a line cannot be read or is no measurement (a number that is not finite, information
    that is not positive definite), or where neither an edge nor two vertices state a step; BadField where an edge joins
    a vertex with itself.
    """
    edges = list(_edges(text))
    placed = dict(_vertices(text))
    vertices = sorted({end for edge in edges for end in edge[:2]} | set(placed))
    ordinals = {vertex: row for row, vertex in enumerate(vertices)}
    steps: dict[int, tuple[se3.Matrix4, Array64]] = {}
    loops: list[LoopEdge] = []
    for one, other, T_first_second, covariance in edges:
        first, second = ordinals[one], ordinals[other]
        turn = se3.adjoint(T_first_second)
        in_first = turn @ covariance @ turn.T
        if abs(second - first) == 1 and min(first, second) not in steps:
            forward = second > first
            steps[min(first, second)] = (
                (T_first_second, covariance) if forward else (se3.inverse(T_first_second), in_first)
            )
            continue
        ends = Node(session, first), Node(session, second)
        loops.append(LoopEdge(f"{one}-{other}-{len(loops)}", *ends, T_first_second, in_first))
    if not steps:
        raise MalformedBody("the g2o graph has no EDGE_SE2 and no EDGE_SE3:QUAT between successive vertices")
    steps |= {
        row: _unknown_step(placed, *vertices[row : row + 2]) for row in range(len(vertices) - 1) if row not in steps
    }
    poses = [np.eye(4)]
    for number in range(len(steps)):
        poses.append(poses[-1] @ steps[number][0])
    trajectory = Trajectory(session, np.stack(poses), np.stack([steps[n][1] for n in range(len(steps))]))
    return PoseGraph.of([trajectory], loops)


def _unknown_step(placed: Mapping[int, se3.Matrix4], one: int, other: int) -> tuple[se3.Matrix4, Array64]:
    """The step between two vertices that no edge joins. Raises MalformedBody where one of them has no line."""
    if one not in placed or other not in placed:
        raise MalformedBody(f"the g2o graph lacks an edge, or two vertices, for the step from {one} to {other}")
    return se3.inverse(placed[one]) @ placed[other], _UNKNOWN


def _vertices(text: str) -> Iterator[tuple[int, se3.Matrix4]]:
    """The number and the pose of each vertex that has a line; those of others are not known."""
    readers = {"VERTEX_SE3:QUAT": (_spatial_pose, 7), "VERTEX_SE2": (_planar_pose, 3)}
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words or words[0] not in readers:
            continue
        read, count = readers[words[0]]
        try:
            yield int(words[1]), read(_numbers(words[2:], count))
        except (ValueError, IndexError) as error:
            raise MalformedBody(f"a g2o vertex cannot be read ({error}): {line[:80]!r}") from error


def _edges(text: str) -> Iterator[tuple[int, int, se3.Matrix4, Array64]]:
    """Ends, motion and covariance (6, 6), in the frame of the second end, of each edge."""
    readers = {"EDGE_SE3:QUAT": (_spatial, 28), "EDGE_SE2": (_planar, 9)}
    for line in dict.fromkeys(text.splitlines()):
        words = line.split("#")[0].split()
        if not words or words[0] not in readers:
            continue
        read, count = readers[words[0]]
        try:
            yield int(words[1]), int(words[2]), *read(_numbers(words[3:], count))
        except (ValueError, IndexError, np.linalg.LinAlgError) as error:
            raise MalformedBody(f"a g2o edge cannot be read ({error}): {line[:80]!r}") from error


def _numbers(words: Sequence[str], count: int) -> list[float]:
    """So many finite numbers. Raises ValueError."""
    numbers = [float(word) for word in words]
    if len(numbers) != count or not np.abs(numbers).max() < _LARGEST:
        raise ValueError(f"{count} finite numbers are wanted")
    return numbers


def _inverted(information: Array64) -> Array64:
    """A covariance from the upper half of an information matrix. Raises LinAlgError unless positive definite."""
    information = information + np.triu(information, 1).T
    np.linalg.cholesky(information)
    return np.asarray(np.linalg.inv(information))


def _spatial(numbers: list[float]) -> tuple[se3.Matrix4, Array64]:
    information = np.zeros((6, 6))
    information[UPPER] = numbers[7:28]
    return _spatial_pose(numbers), _inverted(HALF_ANGLES @ information @ HALF_ANGLES)


def _spatial_pose(numbers: list[float]) -> se3.Matrix4:
    norm = float(np.linalg.norm(numbers[3:7]))
    if not norm > 0.0:
        raise ValueError("the quaternion is zero")
    return se3.from_quaternion(np.array(numbers[3:7]) / norm, numbers[:3])


def _planar(numbers: list[float]) -> tuple[se3.Matrix4, Array64]:
    information = np.zeros((3, 3))
    information[np.triu_indices(3)] = numbers[3:9]
    covariance = np.eye(6) * _OUT_OF_PLANE
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = _inverted(information)
    return _planar_pose(numbers), covariance


def _planar_pose(numbers: list[float]) -> se3.Matrix4:
    return se3.from_yaw(numbers[2], (numbers[0], numbers[1], 0.0))
