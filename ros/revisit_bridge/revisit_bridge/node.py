"""The ROS 2 node: subscriptions, timers and publishers around `bridge`. With `lifecycle_node` all that needs rclpy."""

from __future__ import annotations

import importlib
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.time import Time as RosTime
from revisit_msgs.msg import LoopClosure, PoseGraph, PoseGraphNode
from revisit_msgs.srv import AddAnchor
from sensor_msgs.msg import NavSatFix, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_ros import Buffer, TransformBroadcaster, TransformException, TransformListener

from revisit.core.geometry import se3
from revisit.sdk.client import Client
from revisit.sdk.errors import ApiError
from revisit.sdk.resources import Relocalisation
from revisit.sdk.scan_choice import Send
from revisit_bridge.answers import Correction, News, ServiceAnswers
from revisit_bridge.bridge import Bridge
from revisit_bridge.map_grid import MapGrids, ServiceMap
from revisit_bridge.messages import matrix
from revisit_bridge.outbox import Outbox, ServiceSessions
from revisit_bridge.pairing import Unknown
from revisit_bridge.parameters import Parameters
from revisit_bridge.publishing import (
    MessageTypes,
    grid_message,
    loop_message,
    pose_graph_message,
    relocalised_message,
    status_message,
    transform_message,
)
from revisit_bridge.relocalising import Relocaliser
from revisit_bridge.session_rule import boot_id

WORK_S = 0.1
PUBLISH_S = 0.1
STATUS_S = 1.0
TF_HISTORY_S = 30.0
TYPES = MessageTypes(
    Time, Header, Point, Vector3, Quaternion, Pose, PoseWithCovariance, PoseWithCovarianceStamped, Transform,
    TransformStamped, LoopClosure, PoseGraphNode, PoseGraph, KeyValue, DiagnosticStatus, DiagnosticArray,
    MapMetaData, OccupancyGrid,
    DiagnosticStatus.OK, DiagnosticStatus.WARN,
)  # fmt: skip


NAME = "revisit_bridge"


class BridgeParts:
    """The bridge of a node, its topics, services and timers; mixed into a class of rclpy's nodes.

    `configure` makes the bridge, which sends scans that wait; `activate` lets clouds in and news out, `deactivate` ends
    that, and `clean_up` lets go of the bridge: scans that are not sent stay on the disk.
    """

    bridge: Bridge | None = None

    def declare(self: Any) -> None:
        """The parameters and the log."""
        logging.getLogger(NAME).addHandler(_RosLog(self.get_logger()))
        logging.getLogger(NAME).setLevel(logging.INFO)
        for item in Parameters.declared():
            self.declare_parameter(item.name, item.default)
        self.add_on_set_parameters_callback(self._set)
        self._active: list[tuple[Any, Any]] = []

    def configure(self: Any) -> None:
        """Raises ValueError where a parameter cannot be; RevisitError where a spool cannot be used."""
        values = {item.name: self.get_parameter(item.name).value for item in Parameters.declared()}
        self.parameters = Parameters.of(values)
        self.bridge = self._bridge()
        self._tf = Buffer(cache_time=Duration(seconds=TF_HISTORY_S))
        self._listener = TransformListener(self._tf, self)
        self._broadcaster = TransformBroadcaster(self)
        self._correction: Correction | None = None
        self._corrected_session = ""
        source = ServiceMap(self._client, f"maps/{self.parameters.map_id}")
        self.grids = MapGrids(source, self.parameters.grid_m, self.parameters.grid_ever)
        self._publish()
        self.bridge.start()

    def activate(self: Any) -> None:
        """Subscribe, offer the services, start the timers."""
        self._subscribe()
        self._offer()

    def deactivate(self: Any) -> None:
        """Take no cloud in and publish nothing."""
        for destroy, made in self._active:
            destroy(made)
        self._active.clear()

    def clean_up(self: Any) -> None:
        """Stop; scans that are not sent stay on the disk."""
        if self.bridge is None:
            return
        self.grids.close()
        self.bridge.close()
        self.bridge = None
        self._client.close()
        self._listener.unregister()
        for publisher in (self._loops, self._graph, self._map, self._relocalised, self._status):
            if publisher is not None:
                self.destroy_publisher(publisher)

    def _bridge(self: Any) -> Bridge:
        own = self.parameters
        folder = Path(own.spool_dir).expanduser() if own.spool_dir else Path.home() / ".revisit" / "spool"
        self._client = Client.grpc(own.service)
        send: Send = "all" if own.send == "all" else "described"
        sessions = ServiceSessions(self._client, own.robot_id, own.spool_max_mb * 2**20, own.drift, send)
        outbox = Outbox(folder, own.map_id, sessions, time.monotonic, own.storey)
        answers = ServiceAnswers(self._client)
        state_file, relocaliser = folder / "last_scan.json", Relocaliser(self._conversation)
        return Bridge(own, self._lookup, outbox, answers, boot_id(), state_file, time.monotonic, relocaliser)

    def _conversation(self: Any, own_session: str) -> Any:
        own = self.parameters
        return self._client.relocalise(own.map_id, storey=own.storey or None, exclude_session=own_session or None)

    def _subscribe(self: Any) -> None:
        own = self.parameters
        inputs = [(_cloud_class(own.cloud_type), own.cloud_topic, self.bridge.take_cloud)]
        if own.odometry_topic:
            inputs.append((Odometry, own.odometry_topic, self.bridge.take_odometry))
        if own.fix_topic:
            inputs.append((NavSatFix, own.fix_topic, self.bridge.take_fix))
        for kind, topic, take in inputs:
            made = self.create_subscription(kind, topic, take, qos_profile_sensor_data)
            self._active.append((self.destroy_subscription, made))

    def _offer(self: Any) -> None:
        own = self.parameters
        services = [(Trigger, name) for name in ("end_session", "relocalise", "optimise_map", "save_map")]
        for kind, name in [*services, (AddAnchor, "add_anchor")]:
            made = self.create_service(kind, f"~/{name}", getattr(self, f"_{name}"))
            self._active.append((self.destroy_service, made))
        timers = [(WORK_S, self.bridge.work), (PUBLISH_S, self._tell), (STATUS_S, self._tell_status)]
        if own.grid_m:
            timers.append((own.grid_every_s, self._follow_map))
        for period_s, work in timers:
            self._active.append((self.destroy_timer, self.create_timer(period_s, work)))

    def _publish(self: Any) -> None:
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._loops = self.create_publisher(LoopClosure, "~/loop_closures", QoSProfile(depth=100))
        self._graph = self.create_publisher(PoseGraph, "~/pose_graph", kept)
        self._map = self.create_publisher(OccupancyGrid, "map", kept) if self.parameters.grid_m else None
        self._relocalised = self.create_publisher(PoseWithCovarianceStamped, "~/relocalised", kept)
        self._status = self.create_publisher(DiagnosticArray, "/diagnostics", QoSProfile(depth=1))

    def _lookup(self: Any, target: str, source: str, stamp: int) -> se3.Matrix4 | Unknown:
        """See `pairing.Mountings`. tf2 tells apart neither too early nor unknown: the cloud's own patience ends it."""
        try:
            found = self._tf.lookup_transform(target, source, RosTime(nanoseconds=stamp)).transform
        except TransformException:
            return Unknown.NOT_YET
        return matrix(found.translation, found.rotation)

    def _tell(self: Any) -> None:
        """Publish what is new, and the transform that holds."""
        for news in self.bridge.news():
            self._tell_news(news)
        for answer in self.bridge.relocalisations():
            self._tell_relocalisation(answer)
        if self._map is not None and (made := self.grids.news()) is not None:
            now_ns = self.get_clock().now().nanoseconds
            self._map.publish(grid_message(TYPES, made, self.parameters.map_frame, now_ns))
        correction = self._correction
        if correction is None or not self.parameters.publish_tf:
            return
        if self._corrected_session != self.bridge.outbox.state.session:
            self._correction = None  # of a session that has ended: its odometry frame is no more
            return
        ahead_ns = int(self.parameters.tf_tolerance_s * 1e9)
        stamp_ns = self.get_clock().now().nanoseconds + ahead_ns
        frames = self.parameters.map_frame, self.bridge.odom_frame
        self._broadcaster.sendTransform(transform_message(TYPES, correction, frames, stamp_ns))

    def _tell_news(self: Any, news: News) -> None:
        for loop in news.found:
            self._loops.publish(loop_message(TYPES, loop))
        for loop in news.revoked:
            self._loops.publish(loop_message(TYPES, loop, revoked=True))
        now_ns = self.get_clock().now().nanoseconds
        self._graph.publish(pose_graph_message(TYPES, news.answer, self.bridge.odom_frame, now_ns))
        self._correction, self._corrected_session = news.answer.correction, news.answer.session

    def _tell_relocalisation(self: Any, answer: Relocalisation) -> None:
        """Publish the one pose; say what else was told."""
        now_ns = self.get_clock().now().nanoseconds
        placed = answer.poses[0] if answer.state == "PLACED" else None
        message = placed and relocalised_message(TYPES, placed, self.parameters.map_frame, now_ns)
        if message is not None:
            self._relocalised.publish(message)
        told = f"{answer.reason or answer.state}, {len(answer.poses)} poses"
        self.get_logger().info(f"relocalisation after {answer.travelled_m:.0f} m: {told}")

    def _tell_status(self: Any) -> None:
        now_ns = self.get_clock().now().nanoseconds
        state, left_out, sightings = self.bridge.outbox.state, self.bridge.left_out, self.bridge.sightings
        self._status.publish(status_message(TYPES, state, self.bridge.problem, left_out, sightings, now_ns))

    def _end_session(self: Any, _: Any, response: Any) -> Any:
        self.bridge.end_session()
        response.success, response.message = True, "the next scan begins a new session"
        return response

    def _relocalise(self: Any, _: Any, response: Any) -> Any:
        response.success = self.bridge.relocalise()
        response.message = "the scans to come are asked about" if response.success else "that is being asked already"
        return response

    def _add_anchor(self: Any, request: Any, response: Any) -> Any:
        response.success, response.message = self.bridge.add_anchor(request)
        return response

    def _follow_map(self: Any) -> None:
        self.grids.follow(self.bridge.outbox.state.session)

    def _optimise_map(self: Any, _: Any, response: Any) -> Any:
        """Ask for a new version of the map, in a thread: the transform and the grid follow it."""
        threading.Thread(target=self._ask_to_optimise, name="revisit optimise", daemon=True).start()
        response.success, response.message = True, "asked for; the log tells the outcome"
        return response

    def _ask_to_optimise(self: Any) -> None:
        try:
            operation = self._client.optimise_map(f"maps/{self.parameters.map_id}")
        except ApiError as error:
            self.get_logger().warning(f"no new version of the map: {error.message}")
        else:
            self.get_logger().info(f"{operation.name} computes a new version of the map")

    def _save_map(self: Any, _: Any, response: Any) -> Any:
        """The grid that was published last, as files for map_server."""
        made, own = self.grids.made, self.parameters
        if made is None:
            why = "no version of the map yet" if own.grid_m else "grid_m is 0: no grid is made"
            response.success, response.message = False, why
            return response
        folder = Path(own.map_folder).expanduser() if own.map_folder else Path.home() / ".revisit" / "maps"
        try:
            saved = made.save(folder, own.map_id)
        except OSError as error:
            response.success, response.message = False, f"{folder}: {error.strerror}"
            return response
        response.success, response.message = True, f"version {made.version} in {saved}"
        return response

    def _set(self: Any, parameters: Any) -> Any:
        """The storey can be set while the node runs, its other parameters are read when it starts."""
        if self.bridge is None:
            return SetParametersResult(successful=True)
        values = {parameter.name: parameter.value for parameter in parameters}
        fixed = [item.name for item in Parameters.declared() if item.name in values and item.name != "storey"]
        if fixed:
            return SetParametersResult(successful=False, reason=f"{', '.join(fixed)}: read when the node starts")
        try:
            if "storey" in values:
                self.bridge.change_storey(values["storey"])
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _cloud_class(cloud_type: str) -> Any:
    """The class of a message; that of Livox is of the driver's own package, which is looked for where it is named."""
    package, _, name = cloud_type.partition("/")
    return PointCloud2 if package == "sensor_msgs" else getattr(importlib.import_module(f"{package}.msg"), name)


class BridgeNode(BridgeParts, Node):
    """`revisit_bridge`: active from its start to its end."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self.declare()
        self.configure()
        self.activate()

    def destroy_node(self) -> None:
        """Stop; scans that are not sent stay on the disk."""
        self.deactivate()
        self.clean_up()
        super().destroy_node()


class _RosLog(logging.Handler):
    """The bridge's log in that of ROS."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Hand a record on."""
        tell = self._logger.warning if record.levelno >= logging.WARNING else self._logger.info
        tell(record.getMessage())


def main(make: Callable[[], Any] = BridgeNode) -> None:
    """`ros2 run revisit_bridge bridge`."""
    rclpy.init()
    node = make()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
