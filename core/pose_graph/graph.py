"""Trajectories of sessions and the loops between their submaps."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3

Array64 = NDArray[np.float64]

ASSUMED_COVARIANCE = np.diag([0.1**2] * 3 + [np.radians(1.8) ** 2] * 3)
"""Of a loop that came without a covariance: 0.1 m and 1.8 degrees."""

LEAST_VARIANCE = 1e-8
"""m^2 and rad^2: no measurement is surer, and an information matrix stays finite."""


_ROUNDING = 1e-9
"""Of the largest variance of a covariance: by so much its least one may be below zero."""


def loop_covariance(measured: Array64 | None) -> Array64:
    """The covariance (6, 6) to weigh a loop with: the measured one with a floor, or an assumed one."""
    return loop_covariances([measured])[0]


def loop_covariances(measured: Sequence[Array64 | None]) -> list[Array64]:
    """`loop_covariance` of each of some loops. Raises BadField where one is not finite or has a negative variance."""
    stated = np.reshape([ASSUMED_COVARIANCE if one is None else one for one in measured], (-1, 6, 6))
    if not np.isfinite(stated).all():
        raise BadField("a loop's covariance must be finite", field="covariance")
    variances, axes = np.linalg.eigh(stated)
    if (variances[:, 0] < -_ROUNDING * variances[:, -1]).any():
        raise BadField("a loop's covariance must be positive semidefinite", field="covariance")
    floored = (axes * np.maximum(variances, LEAST_VARIANCE)[:, None, :]) @ axes.transpose(0, 2, 1)
    return [ASSUMED_COVARIANCE if one is None else known for one, known in zip(measured, floored, strict=True)]


class GraphState(StrEnum):
    """The verdict of the graph on an accepted loop."""

    IN_MAP = "IN_MAP"
    SET_ASIDE = "SET_ASIDE"
    UNCONNECTED = "UNCONNECTED"


class Node(NamedTuple):
    """A submap: the name of its session and its place in it, from 0."""

    session: str
    ordinal: int


ODOMETRY_CLASSES = {"WHEEL": (0.03, 0.3), "VISUAL": (0.015, 0.08), "LIDAR_INERTIAL": (0.004, 0.02)}
"""Drift of odometry by its sensor, metres a metre and degrees a metre: one standard deviation of a step."""

_DRIFT = re.compile(r"(\d+(?:\.\d+)?) m/m (\d+(?:\.\d+)?) deg/m")
_LEAST_DRIFT, _MOST_DRIFT = (0.0005, 0.001), (0.5, 5.0)
_LEAST_STEP_M = 2.0


@dataclass(frozen=True)
class OdometryModel:
    """How fast odometry drifts: standard deviations that grow with the distance travelled, and their least values.

    translation 1 (metres a metre), rotation_rad_per_m; least_translation_m and least_rotation_rad for a step of any
    length.
    """

    translation: float = 0.01
    rotation_rad_per_m: float = 2e-3
    least_translation_m: float = 0.02
    least_rotation_rad: float = 2e-3

    @classmethod
    def stated(cls, drift: str | None) -> OdometryModel:
        """The model by a statement: one of ODOMETRY_CLASSES, or as "0.03 m/m 0.1 deg/m"; the default where it is None.

        A step of less than 2 m drifts as one of 2 m, or less. Raises BadField for anything else, and beyond 0.0005 to
        0.5 m/m or 0.001 to 5 deg/m.
        """
        if drift is None:
            return cls()
        figures = _DRIFT.fullmatch(drift)
        translation, rotation_deg = (
            (float(figures[1]), float(figures[2])) if figures else ODOMETRY_CLASSES.get(drift, (np.nan, np.nan))
        )
        (least, least_deg), (most, most_deg) = _LEAST_DRIFT, _MOST_DRIFT
        if not (least <= translation <= most and least_deg <= rotation_deg <= most_deg):
            message = f"drift must be one of {', '.join(ODOMETRY_CLASSES)}, or as '0.03 m/m 0.1 deg/m' within bounds"
            raise BadField(message, field="drift")
        rotation = float(np.radians(rotation_deg))
        return cls(
            translation,
            rotation,
            min(cls.least_translation_m, _LEAST_STEP_M * translation),
            min(cls.least_rotation_rad, _LEAST_STEP_M * rotation),
        )

    def covariances(self, steps_m: Array64) -> Array64:
        """Covariances (n, 6, 6) of steps (n,) metres long, tangent (x, y, z, rx, ry, rz) at the step's end."""
        translation = np.maximum(self.translation * steps_m, self.least_translation_m)
        rotation = np.maximum(self.rotation_rad_per_m * steps_m, self.least_rotation_rad)
        variances = np.stack([translation] * 3 + [rotation] * 3, axis=1) ** 2
        return np.asarray(variances[:, :, None] * np.eye(6))


@dataclass(frozen=True)
class Trajectory:
    """The submaps of a session in order.

    T_odom_submap (n, 4, 4); step_covariances (n - 1, 6, 6) of the motion from each submap to the next, of the tangent
    (x, y, z, rx, ry, rz) in the frame of the later one, metres and radians. odometry: the model that these are by, if
    any; mended: the submaps from which and up to which steps are not as odometry had them; jumps: the submaps behind
    which it is known to jump (see `jumps`).
    """

    session: str
    T_odom_submap: Array64
    step_covariances: Array64
    odometry: OdometryModel | None = None
    mended: tuple[tuple[int, int], ...] = ()
    jumps: tuple[int, ...] = ()

    @classmethod
    def from_odometry(cls, session: str, T_odom_submap: Array64, model: OdometryModel = OdometryModel()) -> Trajectory:
        """A trajectory whose steps are as uncertain as `model` says."""
        steps_m = np.linalg.norm(np.diff(T_odom_submap[:, :3, 3], axis=0), axis=1)
        return cls(session, np.asarray(T_odom_submap, dtype=np.float64), model.covariances(steps_m), model)

    def __len__(self) -> int:
        return len(self.T_odom_submap)

    @cached_property
    def _drift_sums(self) -> Array64:
        """Sums (n, 6) over the steps up to each submap: variance of translation; variance v of rotation; v * position
        of the step (3); v * its squared distance from the origin.
        """
        diagonals = np.diagonal(self.step_covariances, axis1=1, axis2=2)
        translation, rotation = diagonals[:, :3].mean(axis=1), diagonals[:, 3:].mean(axis=1)
        places = self.T_odom_submap[1:, :3, 3]
        weighted = rotation[:, None] * places
        steps = np.column_stack([translation, rotation, weighted, (weighted * places).sum(axis=1)])
        return np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])

    def drift(self, ordinals: NDArray[np.int64], ends: NDArray[np.int64] | int) -> tuple[Array64, Array64]:
        """How far odometry may have drifted between submaps (n,) and submaps `ends` (n,), or one for all.

        Variances (n,) of the position of the end, m^2, and of the rotation, rad^2. A wrong turn on the way displaces
        the end by its distance from where it was taken, also where the way comes back to its beginning.
        """
        sums, ends = self._drift_sums, np.broadcast_to(ends, np.shape(ordinals))
        between = np.where(ordinals < ends, 1.0, -1.0)[:, None] * (sums[ends] - sums[ordinals])
        places = self.T_odom_submap[ends, :3, 3]
        turns = between[:, 1] * _dot(places, places) - 2.0 * _dot(between[:, 2:5], places) + between[:, 5]
        return np.asarray(between[:, 0] + np.maximum(turns, 0.0)), np.asarray(between[:, 1])


def _dot(first: Array64, second: Array64) -> Array64:
    """Scalar products (n,) of vectors (n, 3)."""
    return np.asarray(np.einsum("ni,ni->n", first, second))


@dataclass(frozen=True)
class LoopEdge:
    """A loop: T_match_query (4, 4) maps the frame of submap `query` into that of submap `match`.

    covariance (6, 6) of its tangent (x, y, z, rx, ry, rz) in the match frame, as verification states it. A loop from
    overlapping windows shares information with its neighbours; `independent_share` 0..1 is its own contribution.
    """

    name: str
    match: Node
    query: Node
    T_match_query: se3.Matrix4
    covariance: Array64
    independent_share: float = 1.0

    @property
    def covariance_in_query(self) -> Array64:
        """The covariance (6, 6) of the tangent in the query frame: also that of the inverse, T_query_match."""
        turn = se3.adjoint(se3.inverse(self.T_match_query))
        return np.asarray(turn @ self.covariance @ turn.T)


def _require_measured(trajectory: Trajectory) -> None:
    """Raises BadField where a pose of a trajectory is not finite, or a step has no covariance."""
    lost = np.flatnonzero(~np.isfinite(trajectory.T_odom_submap).all(axis=(1, 2)))
    if len(lost):
        raise BadField(f"submap {lost[0]} of {trajectory.session} has a pose that is not finite", field="T_odom_submap")
    unknown = np.flatnonzero(~_are_covariances(trajectory.step_covariances))
    if len(unknown):
        message = f"step {unknown[0]} of {trajectory.session} has a covariance that is not finite and positive definite"
        raise BadField(message, field="step_covariances")


def _require_measurements(loops: Sequence[LoopEdge]) -> None:
    """Raises BadField where the motion of a loop is not finite, or where it has no covariance."""
    poses = np.reshape([one.T_match_query for one in loops], (-1, 4, 4))
    for one in itertools.compress(loops, ~np.isfinite(poses).all(axis=(1, 2))):
        raise BadField(f"loop {one.name} has a T_match_query that is not finite", field="loops")
    known = _are_covariances(np.reshape([one.covariance for one in loops], (-1, 6, 6)))
    for one in itertools.compress(loops, ~known):
        raise BadField(f"loop {one.name} has a covariance that is not finite and positive definite", field="loops")


def _are_covariances(matrices: Array64) -> NDArray[np.bool_]:
    """Which matrices (n, 6, 6) are finite and positive definite."""
    finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    variances = np.linalg.eigvalsh(np.where(finite[:, None, None], matrices, np.eye(6)))
    return np.asarray(finite & (variances[:, 0] > 0.0))


@dataclass(frozen=True)
class PoseGraph:
    """Sessions and loops, in an order of their own: the same content gives the same graph, bit for bit.

    `anchors` names sessions, the most preferred first: that of a component gives its frame. None named, its first does.
    """

    trajectories: tuple[Trajectory, ...]
    loops: tuple[LoopEdge, ...]
    anchors: tuple[str, ...] = ()

    @classmethod
    def of(cls, trajectories: list[Trajectory], loops: list[LoopEdge], anchors: tuple[str, ...] = ()) -> PoseGraph:
        """A graph in canonical order.

        Raises BadField where a loop names a submap that is not there, or itself, where a pose is not finite, and where
        a covariance is not finite or not positive definite.
        """
        for one in trajectories:
            _require_measured(one)
        _require_measurements(loops)
        ordered = tuple(sorted(trajectories, key=lambda one: one.session))
        lengths = {one.session: len(one) for one in ordered}
        for loop in loops:
            for node in (loop.match, loop.query):
                if not 0 <= node.ordinal < lengths.get(node.session, 0):
                    raise BadField(f"loop {loop.name} names submap {node.ordinal} of {node.session}", field="loops")
            if loop.match == loop.query:
                raise BadField(f"loop {loop.name} joins a submap with itself", field="loops")
        return cls(ordered, tuple(sorted(loops, key=lambda one: (one.match, one.query, one.name))), anchors)

    @cached_property
    def by_session(self) -> dict[str, Trajectory]:
        """The trajectories by the name of their session."""
        return {one.session: one for one in self.trajectories}
