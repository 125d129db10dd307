"""Answers as ROS messages. The classes of the messages are given, so that this module needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.formats.occupancy_grid import FREE, OCCUPIED
from revisit.sdk.resources import RelocalisedPose, Submap
from revisit_bridge.answers import UNMEASURED, Answer, Correction, Loop
from revisit_bridge.map_grid import MapGrid
from revisit_bridge.outbox import OutboxState
from revisit_bridge.sightings import Sightings

ODOMETRY_SHARE = 0.01
"""Of the way between two submaps that the odometry is assumed to be wrong by; nobody has measured it."""


@dataclass(frozen=True)
class MessageTypes:
    """Classes of the messages by name, made with keywords: of rclpy, or of any other library."""

    Time: Any
    Header: Any
    Point: Any
    Vector3: Any
    Quaternion: Any
    Pose: Any
    PoseWithCovariance: Any
    PoseWithCovarianceStamped: Any
    Transform: Any
    TransformStamped: Any
    LoopClosure: Any
    PoseGraphNode: Any
    PoseGraph: Any
    KeyValue: Any
    DiagnosticStatus: Any
    DiagnosticArray: Any
    MapMetaData: Any
    OccupancyGrid: Any
    ok: Any
    warning: Any


def transform_message(types: MessageTypes, correction: Correction, frames: tuple[str, str], stamp_ns: int) -> Any:
    """TransformStamped of the frames (map, odometry)."""
    x, y, z = (float(value) for value in correction.T_map_odom[:3, 3])
    return types.TransformStamped(
        header=_header(types, stamp_ns, frames[0]),
        child_frame_id=frames[1],
        transform=types.Transform(
            translation=types.Vector3(x=x, y=y, z=z), rotation=_quaternion(types, correction.T_map_odom)
        ),
    )


def relocalised_message(types: MessageTypes, pose: RelocalisedPose, map_frame: str, stamp_ns: int) -> Any | None:
    """geometry_msgs/PoseWithCovarianceStamped of the sensor; None where no version of the map has its session."""
    if pose.in_map is None:
        return None
    placed = _with_covariance(types, pose.in_map.T_map, pose.covariance)
    return types.PoseWithCovarianceStamped(header=_header(types, stamp_ns, map_frame), pose=placed)


def loop_message(types: MessageTypes, loop: Loop, *, revoked: bool = False) -> Any:
    """revisit_msgs/LoopClosure."""
    return types.LoopClosure(
        name=loop.closure.name,
        query=loop.query.name,
        match=loop.match.name,
        query_stamp=_time(types, loop.query.stamp_ns),
        match_stamp=_time(types, loop.match.stamp_ns),
        match_from_query=_with_covariance(types, loop.T_match_query, loop.covariance),
        odom_query=_pose(types, loop.query.T_odom_submap),
        odom_match=_pose(types, loop.match.T_odom_submap),
        score=float(loop.closure.score),
        revoked=revoked,
    )


def pose_graph_message(types: MessageTypes, answer: Answer, odom_frame: str, stamp_ns: int) -> Any:
    """revisit_msgs/PoseGraph: the session's submaps in its odometry frame, and all its loops."""
    own = [submap for submap in answer.submaps if submap.state != "FAILED"]
    return types.PoseGraph(
        header=_header(types, stamp_ns, odom_frame),
        session=answer.session,
        nodes=[_node(types, submap) for submap in own],
        odometry_covariance=np.array([_variance(step) for step in _steps(own)], dtype=np.float64),
        loops=[loop_message(types, loop) for loop in answer.loops],
    )


def grid_message(types: MessageTypes, made: MapGrid, map_frame: str, stamp_ns: int) -> Any:
    """nav_msgs/OccupancyGrid: 100 occupied, 0 free, -1 unknown, the rows from the lowest y on."""
    grid, stamp = made.grid, _time(types, stamp_ns)
    rows, columns = grid.cells.shape
    corner = se3.from_yaw(0.0, (*grid.origin, 0.0))
    values = np.full(grid.cells.shape, -1, dtype=np.int8)
    values[grid.cells == FREE], values[grid.cells == OCCUPIED] = 0, 100
    info = types.MapMetaData(
        map_load_time=stamp, resolution=grid.resolution_m, width=columns, height=rows, origin=_pose(types, corner)
    )
    return types.OccupancyGrid(header=_header(types, stamp_ns, map_frame), info=info, data=values[::-1].ravel())


def status_message(
    types: MessageTypes, state: OutboxState, error: str, left_out: int, sightings: Sightings, stamp_ns: int
) -> Any:
    """DiagnosticArray: what waits, what is stored, and what is wrong."""
    problem = error or state.error or (f"refused for good: {', '.join(state.stuck)}" if state.stuck else "")
    values = {
        "session": state.session, "scans waiting": state.pending, "last scan stored": state.committed_seq or 0,
        "scans refused": state.dead_letters, "clouds without a pose": left_out,
        "anchors waiting": state.anchors_waiting, "anchors stored": state.anchors_stored,
        "anchors lost": state.anchors_lost, "fixes without a place": sightings.no_place,
        "fixes left out": sightings.left_out,
    }  # fmt: skip
    status = types.DiagnosticStatus(
        level=types.warning if problem else types.ok,
        name="revisit_bridge",
        message=problem or "ok",
        hardware_id="",
        values=[types.KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
    return types.DiagnosticArray(header=_header(types, stamp_ns, ""), status=[status])


def _node(types: MessageTypes, submap: Submap) -> Any:
    return types.PoseGraphNode(
        name=submap.name, stamp=_time(types, submap.stamp_ns), pose=_pose(types, submap.T_odom_submap)
    )


def _steps(submaps: list[Submap]) -> list[float]:
    """Metres between each submap and the next."""
    positions = [submap.T_odom_submap[:3, 3] for submap in submaps]
    return [float(np.linalg.norm(after - before)) for before, after in pairwise(positions)]


def _variance(step_m: float) -> float:
    return max(0.01, ODOMETRY_SHARE * step_m) ** 2


def _with_covariance(types: MessageTypes, transform: se3.Matrix4, covariance: NDArray[np.float64]) -> Any:
    flat = (covariance if covariance.shape == (6, 6) else UNMEASURED).reshape(36)
    return types.PoseWithCovariance(pose=_pose(types, transform), covariance=flat)


def _pose(types: MessageTypes, transform: se3.Matrix4) -> Any:
    x, y, z = (float(value) for value in transform[:3, 3])
    return types.Pose(position=types.Point(x=x, y=y, z=z), orientation=_quaternion(types, transform))


def _quaternion(types: MessageTypes, transform: se3.Matrix4) -> Any:
    x, y, z, w = (float(value) for value in se3.to_quaternion(transform))
    return types.Quaternion(x=x, y=y, z=z, w=w)


def _header(types: MessageTypes, stamp_ns: int, frame: str) -> Any:
    return types.Header(stamp=_time(types, stamp_ns), frame_id=frame)


def _time(types: MessageTypes, stamp_ns: int) -> Any:
    return types.Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
