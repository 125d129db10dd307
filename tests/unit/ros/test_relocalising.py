"""The bridge asks where the robot is: scans go in, answers come out, without ROS."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.publishing import MessageTypes, relocalised_message
from revisit_bridge.relocalising import Relocaliser

from revisit.sdk.errors import ErrorDetails, InvalidArgument, NotFound
from revisit.sdk.resources import MapPose, Relocalisation, RelocalisedPose
from tests.support.patience import eventually
from tests.support.ros_messages import message_classes, ros_store

POINTS = np.ones((4, 3), np.float32)
IN_MAP = RelocalisedPose(in_map=MapPose(np.eye(4), "frame-1", 3), covariance=0.01 * np.eye(6), probability=0.99)


class Service:
    """Answers in turn; an error is raised."""

    def __init__(self, *answers):
        self.answers, self.seen, self.left_out, self.open = list(answers), [], None, 0

    @contextmanager
    def converse(self, own_session):
        self.left_out, self.open = own_session, self.open + 1
        yield self
        self.open -= 1

    def see(self, points, T_odom_sensor):
        self.seen.append(T_odom_sensor[0, 3])
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def offered(relocaliser, service, x_m):
    """Offer a scan and wait until it was seen."""
    pose = np.eye(4)
    pose[0, 3] = x_m
    relocaliser.offer(POINTS, pose)
    eventually(lambda: x_m in service.seen, "the scan was not asked about")


def test_scans_are_asked_about_from_the_request_until_the_robot_is_placed():
    several = Relocalisation(state="SEVERAL", poses=(IN_MAP, IN_MAP))
    bad = InvalidArgument(ErrorDetails("INVALID_ARGUMENT", "EMPTY_CLOUD", "empty"))
    service = Service(several, bad, Relocalisation(state="PLACED", poses=(IN_MAP,)))
    relocaliser = Relocaliser(service.converse)
    relocaliser.offer(POINTS, np.eye(4))
    assert not relocaliser.asking and service.seen == []
    assert relocaliser.begin("maps/yard/sessions/own") and not relocaliser.begin("")
    for x_m in (1.0, 2.0, 3.0):
        offered(relocaliser, service, x_m)
    eventually(lambda: not relocaliser.asking, "the conversation goes on")
    assert (service.left_out, service.open) == ("maps/yard/sessions/own", 0)
    assert [one.state for one in relocaliser.answers()] == ["SEVERAL", "PLACED"]
    assert relocaliser.answers() == [] and relocaliser.error == ""


def test_a_conversation_that_the_service_ends_can_be_begun_again():
    gone = NotFound(ErrorDetails("NOT_FOUND", "NOT_FOUND", "no map 'yard'"))
    service = Service(gone, Relocalisation(state="UNKNOWN", reason="NOT_YET"))
    relocaliser = Relocaliser(service.converse)
    relocaliser.begin("")
    offered(relocaliser, service, 1.0)
    eventually(lambda: not relocaliser.asking, "the conversation goes on")
    assert "no map" in relocaliser.error
    assert relocaliser.begin("")
    offered(relocaliser, service, 2.0)
    relocaliser.close()
    assert not relocaliser.asking and relocaliser.error == ""


def test_the_pose_is_published_in_the_frame_of_the_map_and_only_there():
    classes = message_classes(ros_store())
    types = MessageTypes(**classes, ok=0, warning=1)
    message = relocalised_message(types, IN_MAP, "map", 5)
    assert message.header.frame_id == "map" and message.pose.covariance[0] == pytest.approx(0.01)
    elsewhere = RelocalisedPose(session="maps/yard/sessions/s", covariance=np.eye(6))
    assert relocalised_message(types, elsewhere, "map", 5) is None
