"""What the bridge makes of fixes of satellites, and of points that somebody names: anchors of the session."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.bridge import Bridge
from revisit_bridge.kept_anchors import AnchorPosting, KeptAnchors
from revisit_bridge.outbox import Outbox
from revisit_bridge.pairing import Unknown
from revisit_bridge.parameters import Parameters
from revisit_bridge.sightings import MAX_WAITING

from revisit.core.geometry import se3
from revisit.sdk.anchors import NewAnchor
from revisit.sdk.errors import ErrorDetails, error_of, unreachable
from tests.support.ros_messages import Messages

SECOND = 10**9
START = 1_000 * SECOND
MOUNTINGS = {
    ("lidar", "gps"): (0.3, 0.0, 1.2),
    ("base_link", "lidar"): (0.0, 0.0, 1.5),
    ("base_link", "gps"): (0.3, 0.0, 2.7),
}


@pytest.fixture(scope="module")
def ros():
    return Messages()


class Sent:
    """An outbox that keeps anchors by session, in memory."""

    lost = None

    def __init__(self) -> None:
        self.sessions, self.session_ids = [], set()

    def resume(self, _session_id: str) -> bool:
        self.sessions.append([])
        return True

    def begin(self, session_id: str) -> None:
        self.session_ids.add(session_id)
        self.sessions.append([])

    def end(self) -> None:
        pass

    def close(self) -> None:
        pass

    def send(self, *_: object) -> None:
        pass

    def keep(self, anchor: NewAnchor) -> None:
        self.sessions[-1].append(anchor)


class Robot:
    """Half a metre a tenth of a second; the receiver tells its fix halfway between two scans."""

    def __init__(self, ros: Messages, folder, boot: str = "boot 1", mountings=MOUNTINGS) -> None:
        self.ros, self.outbox, self.now_s, self.mountings = ros, Sent(), 0.0, mountings
        own = Parameters(odometry_topic="odometry", fix_topic="fix")
        state = folder / "last_scan.json"
        self.bridge = Bridge(own, self.transforms, self.outbox, None, boot, state, lambda: self.now_s)

    def transforms(self, target: str, source: str, _: int):
        told = self.mountings.get((target, source))
        return Unknown.NOT_YET if told is None else se3.from_yaw(0.0, told)

    def scan(self, stamp: int, x: float) -> None:
        self.bridge.take_cloud(self.ros.cloud(np.ones((50, 3)), stamp, "lidar"))
        self.bridge.take_odometry(self.ros.odometry(se3.from_yaw(0.0, (x, 0.0, 0.0)), stamp))

    def fix(self, stamp: int, frame: str = "gps", **told: object) -> None:
        self.bridge.take_fix(self.ros.fix(stamp, frame, **told))

    def drive(self, first: int, last: int, step_m: float = 0.5, start: int = START) -> None:
        for index in range(first, last + 1):
            at = start + index * SECOND // 10
            self.scan(at, step_m * index)
            self.fix(at + SECOND // 20)
            self.now_s += 0.1

    def point(self, anchor_id: str = "door-7", at=(4.0, 0.0, 0.0), local_m=(1.0, 2.0, 3.0), stamp: int = 0, **told):
        """A request that a point 4 m ahead lies at a place."""
        return self.ros.add_anchor(anchor_id, at, stamp, local_m=local_m, **told)

    @property
    def anchors(self) -> list[NewAnchor]:
        return self.outbox.sessions[-1]

    @property
    def told(self) -> tuple[int, str]:
        return self.bridge.sightings.left_out, self.bridge.problem


@pytest.fixture
def robot(ros, tmp_path):
    return Robot(ros, tmp_path)


def test_fixes_a_metre_apart_are_anchors_at_the_pose_of_their_time(robot) -> None:
    robot.drive(0, 10)
    assert [one.stamp_ns - START for one in robot.anchors] == [SECOND // 20 + n * SECOND // 5 for n in range(5)]
    second = robot.anchors[1]
    assert (second.kind, second.anchor_id) == ("GNSS", f"gnss-{second.stamp_ns}")
    np.testing.assert_allclose(second.T_odom_sensor, se3.from_yaw(0.0, (1.25, 0.0, 1.5)), atol=1e-9)
    assert second.offset_m == pytest.approx((0.3, 0.0, 1.2)) and second.geodetic == (48.1, 11.5, 520.0)
    assert np.diag(second.covariance_enu).tolist() == [9.0, 9.0, 36.0] and robot.told == (0, "")


def test_a_robot_that_stands_has_one_anchor(robot) -> None:
    robot.drive(0, 30, step_m=0.0)
    assert len(robot.anchors) == 1 and robot.told == (0, "")


def test_a_receiver_without_a_place_gives_none_and_is_counted(robot) -> None:
    robot.scan(START, 0.0)
    for told in ({"status": -1}, {"position": (math.nan, 11.5, 0.0)}, {"position": (0.0, 0.0, 0.0)}):
        robot.fix(START, **told)
    assert robot.anchors == [] and robot.bridge.sightings.no_place == 3 and robot.told == (0, "")


def test_the_covariance_that_a_receiver_tells_is_that_of_the_anchor(robot) -> None:
    told = np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 4.0]])
    robot.scan(START, 0.0)
    robot.fix(START, covariance=told)
    np.testing.assert_allclose(robot.anchors[0].covariance_enu, told)


def test_without_the_mounting_of_the_antenna_fixes_are_left_out_and_the_frame_is_named(ros, tmp_path, caplog) -> None:
    mountings = dict(MOUNTINGS)
    del mountings["lidar", "gps"]
    robot = Robot(ros, tmp_path, mountings=mountings)
    robot.drive(0, 40)
    assert robot.anchors == [] and robot.told[0] >= 15
    assert "TF does not tell where gps is on the robot, from lidar" in robot.told[1]
    assert len([line for line in caplog.messages if "gps" in line]) == 1
    robot.mountings = MOUNTINGS  # it is published at last
    robot.drive(41, 44)
    assert robot.anchors and robot.told[1] == ""


def test_a_fix_that_comes_late_is_of_its_time(robot) -> None:
    for tenth in range(8):
        robot.scan(START + tenth * SECOND // 10, 0.5 * tenth)
    robot.fix(START + SECOND // 4)
    (anchor,) = robot.anchors
    assert anchor.T_odom_sensor[0, 3] == pytest.approx(1.25)


def test_registered_clouds_have_the_antenna_from_the_body(robot) -> None:
    for tenth in range(3):
        stamp, pose = START + tenth * SECOND // 10, se3.from_yaw(0.0, (0.5 * tenth, 0.0, 0.0))
        robot.bridge.take_cloud(robot.ros.cloud(np.ones((50, 3)), stamp, "odom"))
        robot.bridge.take_odometry(robot.ros.odometry(pose, stamp))
    robot.fix(START + SECOND // 10)
    assert robot.anchors[0].offset_m == pytest.approx((0.3, 0.0, 2.7)) and robot.anchors[0].T_odom_sensor[2, 3] == 0.0


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [(500_000, "its time is after the last scan, by 49999"), (-500, "its time is before the session, by 49")],
)
def test_a_receiver_on_another_clock_is_told(robot, ahead_s, words) -> None:
    for tenth in range(40):
        at = START + tenth * SECOND // 10
        robot.scan(at, 0.5 * tenth)
        robot.fix(at + ahead_s * SECOND)
        robot.now_s += 0.1
    assert robot.anchors == [] and robot.told[0] >= 15 and words in robot.told[1]


def test_where_the_odometry_jumps_no_fix_between_both_sessions_is_taken(robot) -> None:
    robot.drive(0, 4)
    robot.drive(205, 209)  # a hundred metres and 20 s on
    first, second = robot.outbox.sessions
    assert max(one.stamp_ns for one in first) < START + 4 * SECOND // 10
    assert min(one.stamp_ns for one in second) > START + 205 * SECOND // 10
    assert {one.T_odom_sensor[0, 3] > 100 for one in second} == {True}


def test_a_clock_that_goes_back_begins_anew(robot) -> None:
    robot.drive(0, 9)
    robot.drive(0, 9, start=START - 500 * SECOND)
    robot.fix(START + SECOND // 2)  # late, of the clock before
    first, second = robot.outbox.sessions
    assert (len(first), len(second)) == (5, 4)  # the first cloud of the new clock has no pose
    assert {one.stamp_ns < START for one in second} == {True}


def test_an_ended_session_gets_no_fix_of_the_time_behind_it(robot) -> None:
    robot.drive(0, 4)
    robot.bridge.end_session()
    robot.fix(START + SECOND)
    robot.drive(20, 24)
    assert len(robot.outbox.sessions) == 2
    assert {one.stamp_ns > START + 2 * SECOND for one in robot.outbox.sessions[1]} == {True}


def test_after_a_restart_fixes_go_on_with_the_session(ros, robot, tmp_path) -> None:
    robot.drive(0, 6)
    robot.bridge.close()
    again = Robot(ros, tmp_path)
    again.drive(7, 10)
    assert len(again.outbox.sessions) == 1 and again.anchors
    rebooted = Robot(ros, tmp_path, boot="boot 2")
    rebooted.drive(7, 10)
    assert len(rebooted.outbox.sessions) == 2 and rebooted.outbox.sessions[0] == []


def test_fixes_that_no_scan_follows_are_bounded(robot) -> None:
    robot.scan(START, 0.0)
    for index in range(MAX_WAITING + 5):
        robot.fix(START + index + 1)
    assert robot.told[0] == 5 and "more of them wait" in robot.told[1]


def test_a_point_is_an_anchor_of_the_last_scan(robot) -> None:
    assert robot.bridge.add_anchor(robot.point()) == (
        False, "there was no scan: where the robot is in its session is not known"
    )  # fmt: skip
    robot.scan(START, 7.0)
    kept, words = robot.bridge.add_anchor(robot.point())
    assert kept and "on the disk" in words
    (anchor,) = robot.anchors
    assert (anchor.anchor_id, anchor.kind, anchor.stamp_ns) == ("door-7", "CONTROL_POINT", START)
    assert anchor.offset_m == (4.0, 0.0, 0.0) and anchor.local_m == (1.0, 2.0, 3.0) and anchor.geodetic is None
    assert anchor.T_odom_sensor[0, 3] == pytest.approx(7.0) and anchor.heading_rad is None
    assert robot.bridge.add_anchor(robot.point(anchor_id="b"))[0] and len(robot.anchors) == 2  # at one place


def test_a_point_on_earth_in_a_frame_of_the_robot_with_a_heading(robot) -> None:
    robot.drive(0, 2)
    earth = {"on_earth": True, "latitude_deg": 48.1, "longitude_deg": 11.5, "altitude_m": 520.0}
    heading = {"heading_rad": 0.5, "heading_sigma_rad": 0.01}
    stamp = START + SECOND // 20
    asked = robot.point(stamp=stamp, frame="gps", at=(1.0, 0.0, 0.0), anchor_id="", **earth, **heading)
    assert robot.bridge.add_anchor(asked)[0]
    anchor = robot.anchors[-1]
    assert (anchor.kind, anchor.anchor_id) == ("KNOWN_POSE", f"point-{START + SECOND // 20}")
    assert anchor.offset_m == pytest.approx((1.3, 0.0, 1.2)) and anchor.geodetic == (48.1, 11.5, 520.0)
    assert (anchor.heading_rad, anchor.heading_sigma_rad) == (0.5, 0.01)


def test_a_tag_of_unknown_place_is_a_fiducial(robot) -> None:
    robot.scan(START, 7.0)
    assert robot.bridge.add_anchor(robot.point(tag="tag36h11:17", on_earth=True, heading_sigma_rad=0.1))[0]
    (tag,) = robot.anchors
    assert (tag.kind, tag.tag, tag.geodetic, tag.local_m) == ("FIDUCIAL", "tag36h11:17", None, None)
    assert tag.offset_m == (4.0, 0.0, 0.0) and tag.heading_rad is None


def test_a_point_that_is_later_than_the_scans_waits_for_the_next_one(robot) -> None:
    robot.scan(START, 0.0)
    kept, words = robot.bridge.add_anchor(robot.point(stamp=START + SECOND // 20))
    assert kept and "waits for the pose" in words and robot.anchors == []
    robot.scan(START + SECOND // 10, 0.5)
    assert [one.T_odom_sensor[0, 3] for one in robot.anchors] == [pytest.approx(0.25)]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"sigma_m": (0.0, 1.0, 1.0)}, "sigma_m"), ({"local_m": (math.nan, 0.0, 0.0)}, "local_m"),
        ({"at": (math.inf, 0.0, 0.0)}, "point"), ({"stamp": SECOND}, "its time is before the session"),
        ({"on_earth": True, "altitude_m": math.nan}, "altitude_m"),
    ],
)  # fmt: skip
def test_a_point_that_cannot_be_is_refused_with_the_reason(robot, told, words) -> None:
    robot.scan(START, 0.0)
    kept, told_words = robot.bridge.add_anchor(robot.point(**told))
    assert not kept and words in told_words and robot.anchors == []


def anchor(number: int) -> NewAnchor:
    return NewAnchor(f"fix-{number}", "GNSS", number, np.eye(3), geodetic=(48.0, 11.0, 5.0), T_odom_sensor=np.eye(4))


def refusal(code: str, reason: str):
    return error_of(ErrorDetails(code, reason, "so it is"))


def test_anchors_stay_on_the_disk_until_the_service_has_them(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("revisit_bridge.kept_anchors.ANCHORS_AT_ONCE", 4)
    calls, errors = [], [unreachable("the service", "no link")]

    def post(session: str, anchors) -> None:
        if errors:
            raise errors.pop()
        calls.append([one.anchor_id for one in anchors])

    kept, posting = KeptAnchors(tmp_path / "a.anchors"), AnchorPosting(post)
    for number in range(5):
        kept.keep(anchor(number))
    with pytest.raises(Exception, match="UNREACHABLE"):
        posting.empty("maps/m/sessions/s", kept)
    kept.close()
    kept = KeptAnchors(tmp_path / "a.anchors")  # the robot was switched off meanwhile
    assert kept.waiting == 5
    posting.empty("maps/m/sessions/s", kept)
    assert [len(call) for call in calls] == [4, 1] and calls[0][:2] == ["fix-0", "fix-1"]
    assert (kept.waiting, posting.stored, posting.refused) == (0, 5, 0)
    kept.close()
    assert KeptAnchors(tmp_path / "a.anchors").waiting == 0


def test_an_anchor_that_is_refused_costs_that_anchor_and_a_key_that_is_refused_none(tmp_path, caplog) -> None:
    errors = [refusal("UNAUTHENTICATED", "UNAUTHENTICATED")]

    def post(session: str, anchors) -> None:
        if errors:
            raise errors.pop()
        if any(one.stamp_ns == 3 for one in anchors):
            raise refusal("INVALID_ARGUMENT", "BAD_FIELD")

    kept, posting = KeptAnchors(tmp_path / "a.anchors"), AnchorPosting(post)
    for number in range(5):
        kept.keep(anchor(number))
    with pytest.raises(Exception, match="UNAUTHENTICATED"):
        posting.empty("maps/m/sessions/s", kept)
    assert kept.waiting == 5
    posting.empty("maps/m/sessions/s", kept)
    assert (kept.waiting, posting.stored, posting.refused) == (0, 4, 1)
    assert "anchor fix-3 of maps/m/sessions/s was refused: so it is" in caplog.text


class Service:
    """Sessions whose scans all arrive at once; `down` while there is no link."""

    def __init__(self) -> None:
        self.down, self.log, self.error = True, [], unreachable("the service", "no link")

    def stream(self, session: str, spool, storey: str):
        spool.touch()
        self.committed = None if self.down else 1
        state = lambda: SimpleNamespace(pending=0, dead_letters=0, committed_seq=None if self.down else 1)  # noqa: E731
        stream = type("Stream", (), {"state": property(lambda _: state()), "error": None})()
        return type("Opened", (), {"__enter__": lambda _: stream, "__exit__": lambda *_: None})()

    def post_anchors(self, session: str, anchors) -> None:
        if self.error is not None:
            raise self.error
        self.log.append((session[-1], [one.anchor_id for one in anchors]))

    def finish(self, session: str) -> None:
        self.log.append((session[-1], "finished"))


def test_a_session_is_finished_once_the_service_has_its_anchors(tmp_path, caplog) -> None:
    service = Service()
    outbox = Outbox(tmp_path, "m", service, lambda: 0.0)
    outbox.begin("a")
    outbox.keep(anchor(1))
    outbox.tend()
    assert outbox.state.anchors_waiting == 1 and outbox.state.error == ""  # the service has no scan of it yet
    service.down = False
    outbox.begin("b")
    outbox.keep(anchor(2))
    outbox.tend()
    assert service.log == [] and outbox.state.anchors_waiting == 2 and "UNREACHABLE" in outbox.state.error
    service.error = None
    outbox.tend()
    assert service.log == [("a", ["fix-1"]), ("a", "finished"), ("b", ["fix-2"])]
    state = outbox.state
    assert (state.anchors_waiting, state.anchors_stored, state.anchors_lost, state.error) == (0, 2, 0, "")
    assert not list(tmp_path.glob("a.*"))


def test_anchors_of_a_session_that_is_gone_are_told_as_lost(tmp_path, caplog) -> None:
    service = Service()
    service.down, service.error = False, refusal("NOT_FOUND", "NOT_FOUND")
    outbox = Outbox(tmp_path, "m", service, lambda: 0.0)
    outbox.begin("a")
    outbox.keep(anchor(1))
    outbox.end()
    outbox.tend()
    assert (outbox.state.anchors_waiting, outbox.state.anchors_lost) == (0, 1)
    assert "maps/m/sessions/a: 1 anchors are gone" in caplog.text
