"""What the ROS 2 bridge publishes: messages that a ROS 2 type system takes, with the numbers of the service."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.answers import Answer, Correction, Loop, News, Newsroom, ServiceAnswers
from revisit_bridge.outbox import OutboxState
from revisit_bridge.publishing import (
    MessageTypes,
    loop_message,
    pose_graph_message,
    status_message,
    transform_message,
)

from revisit.core.geometry import se3
from revisit.sdk.errors import ErrorDetails, FailedPrecondition, unreachable
from revisit.sdk.resources import LoopClosure, Submap
from tests.support.ros_messages import message_classes, ros_store

SECOND = 10**9
STEP = se3.from_yaw(0.3, (1.0, -2.0, 0.5))
COVARIANCE = np.diag([0.04, 0.05, 0.06, 0.001, 0.002, 0.003])


@pytest.fixture(scope="module")
def store():
    return ros_store()


@pytest.fixture(scope="module")
def types(store):
    return MessageTypes(**message_classes(store), ok=0, warning=1)


def submap(name: str, x: float, stamp_ns: int, state: str = "DESCRIBED") -> Submap:
    pose = se3.from_yaw(0.0, (x, 0.0, 0.0))
    return Submap(
        name=f"maps/m/sessions/{name}", state=state, T_odom_submap=pose, position_m=(x, 0.0, 0.0), stamp_ns=stamp_ns
    )


def loop(number: int = 1, evidence: dict | None = None) -> Loop:
    query, match = submap("tue/submaps/9", 30.0, 90 * SECOND), submap("mon/submaps/2", 4.0, 7 * SECOND + 5)
    closure = LoopClosure(
        name=f"maps/m/loopClosures/{number}", number=number, query=query.name, match=match.name, state="ACCEPTED",
        similarity=0.8, score=0.93, T_match_query=STEP,
        evidence={"measurement": {"covariance": COVARIANCE.tolist()}} if evidence is None else evidence,
    )  # fmt: skip
    return Loop(closure, query, match, closure.T_match_query)


def sent(store, message, kind: str):
    return store.deserialize_cdr(bytes(store.serialize_cdr(message, kind)), kind)


def test_a_loop_carries_transform_covariance_and_times(store, types) -> None:
    message = sent(store, loop_message(types, loop()), "revisit_msgs/msg/LoopClosure")
    placed = message.match_from_query
    assert (placed.pose.position.x, placed.pose.position.y, placed.pose.position.z) == (1.0, -2.0, 0.5)
    assert placed.pose.orientation.z == pytest.approx(np.sin(0.15))
    assert np.allclose(placed.covariance.reshape(6, 6), COVARIANCE)
    assert (message.match_stamp.sec, message.match_stamp.nanosec) == (7, 5)
    assert (message.query, message.odom_query.position.x) == ("maps/m/sessions/tue/submaps/9", 30.0)
    assert message.score == pytest.approx(0.93) and not message.revoked


def test_a_loop_without_a_covariance_has_a_cautious_one(store, types) -> None:
    message = sent(store, loop_message(types, loop(evidence={})), "revisit_msgs/msg/LoopClosure")
    assert np.array_equal(np.diag(message.match_from_query.covariance.reshape(6, 6))[:3], [0.01] * 3)


def test_a_pose_graph_has_the_submaps_that_are_of_use_and_their_steps(store, types) -> None:
    own = (submap("tue/submaps/1", 0.0, 1), submap("tue/submaps/2", 9.0, 2, "FAILED"), submap("tue/submaps/3", 20.0, 3))
    answer = Answer("maps/m/sessions/tue", own, (loop(),), None)
    message = sent(store, pose_graph_message(types, answer, "odom", 5 * SECOND), "revisit_msgs/msg/PoseGraph")
    assert (message.header.frame_id, message.header.stamp.sec) == ("odom", 5)
    assert [node.pose.position.x for node in message.nodes] == [0.0, 20.0]
    assert message.odometry_covariance.tolist() == [pytest.approx(0.2**2)]
    assert len(message.loops) == 1


def test_the_transform_is_that_of_the_odometry_frame_in_the_map(store, types) -> None:
    message = transform_message(types, Correction(STEP, 4), ("map", "odom"), 3 * SECOND)
    message = sent(store, message, "geometry_msgs/msg/TransformStamped")
    assert (message.header.frame_id, message.child_frame_id) == ("map", "odom")
    assert (message.transform.translation.x, message.transform.translation.y) == (1.0, -2.0)


@pytest.mark.parametrize(
    ("error", "stuck", "level", "text"),
    [("", (), 0, "ok"), ("UNREACHABLE", (), 1, "UNREACHABLE"), ("", ("maps/m/sessions/x",), 1, "refused for good")],
)
def test_the_status_says_what_is_wrong(store, types, error, stuck, level, text) -> None:
    state = OutboxState("maps/m/sessions/tue", 12, 1, 40, "", stuck, anchors_lost=2)
    seen = SimpleNamespace(no_place=5, left_out=6)
    message = sent(store, status_message(types, state, error, 3, seen, SECOND), "diagnostic_msgs/msg/DiagnosticArray")
    (status,) = message.status
    assert (status.level, text in status.message) == (level, True)
    told = {item.key: item.value for item in status.values}
    assert told["scans waiting"] == "12" and told["clouds without a pose"] == "3"
    assert (told["anchors lost"], told["fixes without a place"], told["fixes left out"]) == ("2", "5", "6")


class Told:
    """Answers as they are set."""

    def __init__(self) -> None:
        self.loops: tuple[Loop, ...] = ()
        self.error: Exception | None = None

    def ask(self, session: str) -> Answer:
        if self.error:
            raise self.error
        return Answer(session, (), self.loops, None)


def test_each_loop_is_news_once_and_again_when_it_is_revoked() -> None:
    told = Told()
    newsroom = Newsroom(told)

    def news(session: str = "tue") -> tuple[list[int], list[int]]:
        found = newsroom.ask(session)
        assert isinstance(found, News)
        return [item.closure.number for item in found.found], [item.closure.number for item in found.revoked]

    assert news() == ([], [])
    told.loops = (loop(1), loop(2))
    assert news() == ([1, 2], []) and news() == ([], [])
    told.loops = (loop(2), loop(3))
    assert news() == ([3], [1])
    assert news("wed") == ([2, 3], [])


def test_a_question_that_fails_is_told_and_loses_nothing() -> None:
    told = Told()
    newsroom = Newsroom(told)
    told.error = unreachable("the service", "no link")
    assert newsroom.ask("tue") is None and "UNREACHABLE" in newsroom.error
    told.error, told.loops = None, (loop(1),)
    news = newsroom.ask("tue")
    assert news is not None and len(news.found) == 1 and newsroom.error == ""


class Placed:
    """A client of a service whose map has a version with some sessions."""

    def __init__(self, placed: set[str]) -> None:
        self.placed = placed

    def list_submaps(self, session: str) -> list[Submap]:
        return [submap("tue/submaps/1", 0.0, 1)]

    def loop_closures(self, map_name: str, **_: object) -> list[LoopClosure]:
        return []

    def correction(self, session: str) -> SimpleNamespace:
        if session not in self.placed:
            details = ErrorDetails("FAILED_PRECONDITION", "NOT_READY", "no version has the session")
            raise FailedPrecondition(details)
        return SimpleNamespace(T_map_odom=STEP, map_version=7)


def test_the_correction_is_that_of_the_service_and_none_before_there_is_one() -> None:
    answers = ServiceAnswers(Placed({"maps/m/sessions/tue"}))
    found = answers.ask("maps/m/sessions/tue")
    assert found is not None and found.correction is not None
    assert np.array_equal(found.correction.T_map_odom, STEP) and found.correction.version == 7
    before = answers.ask("maps/m/sessions/wed")
    assert before is not None and before.correction is None
