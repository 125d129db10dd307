"""The bridge without ROS: clouds and odometry in, scans on the robot's disk, news of the service out."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.sdk.clouds import PointCloud
from revisit.sdk.errors import ApiError
from revisit.sdk.resources import Relocalisation
from revisit_bridge.anchor_request import sighting_of
from revisit_bridge.answers import Answers, News, Newsroom
from revisit_bridge.messages import cloud_of, fix_of, pose_of, received
from revisit_bridge.outbox import Outbox
from revisit_bridge.pairing import Mountings, OdometryPoses, PosedCloud, TransformPoses, WaitingClouds
from revisit_bridge.parameters import Parameters, require_storey
from revisit_bridge.relocalising import Relocaliser
from revisit_bridge.session_rule import Begun, LastScan, Motion, Repeated, judge, new_session_id
from revisit_bridge.sightings import Outcome, Sightings

log = logging.getLogger("revisit_bridge")
SAVE_S = 1.0


@dataclass
class Journey:
    """What the robot did last: the scan that was offered last."""

    last: LastScan | None = None


class Bridge:
    """Fed by one thread (`take_cloud`, `take_odometry`, `work`); asks the service in a thread of its own."""

    def __init__(
        self,
        parameters: Parameters,
        transforms: Mountings,
        outbox: Outbox,
        answers: Answers,
        boot: str,
        state_file: Path,
        now_s: Callable[[], float],
        relocaliser: Relocaliser | None = None,
    ) -> None:
        """`boot` names the run of the machine, `now_s` is a monotonic clock. Goes on with the session of `state_file`
        if the first scan fits to it.
        """
        self._parameters, self._outbox, self._boot, self._now_s = parameters, outbox, boot, now_s
        self._state_file, self._saved_s = state_file, -SAVE_S
        self._motion = Motion(parameters.max_jump_m, parameters.max_speed_m_s, parameters.max_gap_s)
        self._odometry = OdometryPoses(transforms) if parameters.odometry_topic else None
        source = self._odometry or TransformPoses(parameters.odom_frame, transforms)
        self._clouds = WaitingClouds(
            source, parameters.pose_wait_s, parameters.max_waiting_clouds, now_s, parameters.deskew
        )
        self._sightings = Sightings(source, transforms, outbox.keep, parameters.pose_wait_s, now_s)
        self._journey = Journey(LastScan.load(state_file))
        if self._journey.last is not None and not outbox.resume(self._journey.last.session_id):
            self._journey = Journey()
        self._newsroom = Newsroom(answers)
        self._relocaliser = relocaliser
        self._news: queue.SimpleQueue[News] = queue.SimpleQueue()
        self._refused: dict[str, int] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._ask, name="revisit answers", daemon=True)

    @property
    def odom_frame(self) -> str:
        """The frame of the odometry, as its messages say it, else as the parameters do."""
        told = self._odometry.odom_frame if self._odometry is not None else ""
        return told or self._parameters.odom_frame

    @property
    def outbox(self) -> Outbox:
        """The spools."""
        return self._outbox

    @property
    def left_out(self) -> int:
        """Clouds that got no pose."""
        return self._clouds.left_out

    @property
    def problem(self) -> str:
        """What is wrong just now, "" for nothing."""
        others = [self._newsroom.error, self._sightings.problem]
        return "; ".join([*self._refused, *(other for other in others if other)])

    @property
    def sightings(self) -> Sightings:
        """Fixes and points that become anchors, with counts of those of which none is made."""
        return self._sightings

    def start(self) -> None:
        """Begin to ask the service."""
        self._thread.start()

    def take_odometry(self, message: Any) -> None:
        """A nav_msgs/Odometry. One that is no rigid motion is passed over: odometries publish zeros at their start."""
        if self._odometry is None:
            return
        try:
            self._odometry.take(pose_of(message))
        except RevisitError as error:
            self._complain(f"odometry: {error.message}")
        self.work()

    def take_cloud(self, message: Any) -> None:
        """A sensor_msgs/PointCloud2, or a CustomMsg of Livox's drivers."""
        self._clouds.take(received(message))
        self.work()

    def take_fix(self, message: Any) -> None:
        """A sensor_msgs/NavSatFix: it becomes an anchor once the pose at its time is known."""
        self._sightings.take_fix(fix_of(message))

    def add_anchor(self, request: Any) -> tuple[bool, str]:
        """A request of revisit_msgs/AddAnchor: whether it is kept, or waits, and its state or the reason in words."""
        if self._journey.last is None:
            return False, "there was no scan: where the robot is in its session is not known"
        try:
            outcome = self._sightings.take(sighting_of(request, self._journey.last.stamp_ns))
        except RevisitError as error:
            return False, error.message
        if outcome is Outcome.LEFT_OUT:
            return False, self._sightings.problem
        waits = "waits for the pose at its time" if outcome is Outcome.WAITS else "is on the disk of the robot"
        return True, f"{waits}; the service has it after its session's scans"

    def work(self) -> None:
        """Put the clouds whose poses are known on the disk."""
        for posed in self._clouds.ready():
            self._offer(posed)
        self._sightings.settle()

    def news(self) -> list[News]:
        """What was found since the last call."""
        found = []
        while not self._news.empty():
            found.append(self._news.get())
        return found

    def end_session(self) -> None:
        """The next scan begins a new session; this one is finished once its scans are sent."""
        self._outbox.end()
        self._sightings.end()
        self._journey = Journey()
        self._state_file.unlink(missing_ok=True)

    def change_storey(self, storey: str) -> None:
        """The robot is on another storey: the next scan begins a session there. Raises ValueError for no such name."""
        require_storey(storey)
        if storey != self._parameters.storey:
            self._parameters = replace(self._parameters, storey=storey)
            self._outbox.change_storey(storey)
            self.end_session()

    def relocalise(self) -> bool:
        """Ask where in the map the robot is, scan by scan, until it is placed; False where that is being asked."""
        return self._relocaliser is not None and self._relocaliser.begin(self._outbox.state.session)

    def relocalisations(self) -> list[Relocalisation]:
        """What was told of the robot's pose since the last call."""
        return [] if self._relocaliser is None else self._relocaliser.answers()

    def close(self) -> None:
        """Stop; what is not sent stays on the disk."""
        self._closing.set()
        if self._relocaliser is not None:
            self._relocaliser.close()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self._sightings.end()
        if self._journey.last is not None:
            self._journey.last.save(self._state_file)
        self._outbox.close()

    def _offer(self, posed: PosedCloud) -> None:
        """A cloud with its pose: judged, then given to the stream of its session, which chooses."""
        session_id = self._journey.last.session_id if self._journey.last else ""
        scan = LastScan(
            session_id, self._boot, self.odom_frame, posed.sensor_frame, posed.stamp_ns, posed.T_odom_sensor
        )
        verdict = judge(self._journey.last, scan, self._motion)
        if isinstance(verdict, Repeated):
            return
        lost = self._outbox.lost
        last = self._journey.last
        if last is None or lost is not None or isinstance(verdict, Begun):
            scan = replace(scan, session_id=self._begun(lost or _reason(verdict)))
            self._sightings.begin(scan.sensor_frame, scan.stamp_ns)
        else:
            self._sightings.go_on(scan.sensor_frame, last.stamp_ns, scan.stamp_ns)
        self._remember(scan)
        self._send(posed)

    def _begun(self, reason: str) -> str:
        session_id = new_session_id(self._parameters.robot_id, self._outbox.session_ids)
        log.info("session %s begins: %s", session_id, reason)
        self._outbox.begin(session_id)
        self._journey = Journey()
        return session_id

    def _send(self, posed: PosedCloud) -> None:
        try:
            cloud = self._cloud(posed)
            if self._relocaliser is not None:
                self._relocaliser.offer(cloud.points, posed.T_odom_sensor)
            self._outbox.send(cloud if cloud.columns else cloud.points, posed.T_odom_sensor, posed.stamp_ns)
        except RevisitError as error:
            self._complain(error.message)
            return
        self._refused.clear()

    def _cloud(self, posed: PosedCloud) -> PointCloud:
        """The points (n, 3) in the sensor's frame, with the columns that are to be sent.

        Clouds that are registered in the odometry's frame are taken back. Raises RevisitError.
        """
        columns = self._parameters.sent_columns
        if posed.sensor_frame != self.odom_frame:
            return cloud_of(posed.cloud, posed.motion, columns)
        cloud = cloud_of(posed.cloud, None, columns)
        if self._odometry is None:
            raise RevisitError(f"the clouds are registered in {self.odom_frame}: give those of the sensor")
        here = se3.apply(se3.inverse(posed.T_odom_sensor), cloud.points.astype(np.float64))
        return replace(cloud, points=here.astype(np.float32))

    def _remember(self, scan: LastScan) -> None:
        self._journey.last = scan
        if self._now_s() - self._saved_s >= SAVE_S:
            scan.save(self._state_file)
            self._saved_s = self._now_s()

    def _complain(self, message: str) -> None:
        """Say something once, and count it."""
        if message not in self._refused:
            log.warning("%s", message)
        if len(self._refused) < 20 or message in self._refused:
            self._refused[message] = self._refused.get(message, 0) + 1

    def _ask(self) -> None:
        """Look after the spools and ask for news, until the end."""
        while not self._closing.wait(self._parameters.poll_s):
            try:
                self._outbox.tend()
                session = self._outbox.state.session
                news = self._newsroom.ask(session) if session else None
                if news is not None:
                    self._news.put(news)
            except (ApiError, RevisitError) as error:
                log.warning("%s", error)


def _reason(verdict: object) -> str:
    return verdict.reason if isinstance(verdict, Begun) else ""
