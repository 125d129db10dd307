"""Conversations about where a robot is: their messages to the use case, and its answers to messages."""

from __future__ import annotations

from revisit.service.features.relocalisation.calls import StartConversation
from revisit.service.features.relocalisation.rules import ToldPose, ViewAnswer
from revisit.service.wire import names
from revisit.service.wire.fields import Fields, fields_of, transform_fields
from revisit.v1 import loop_closure_pb2 as pb


def conversation_to_start(request: pb.RelocaliseOpen) -> StartConversation:
    """The conversation to begin. Raises BadField."""
    return StartConversation(
        map_id=names.map_id(request.parent, "parent"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        storey=request.storey or None,
    )


def view_fields(view: ViewAnswer) -> Fields:
    """The fields of a RelocaliseAnswer."""
    answer = view.answer
    return fields_of(
        pb.RelocaliseAnswer,
        answer,
        reason=answer.reason or "",
        poses=[_pose_fields(one) for one in view.poses],
        on_other_storeys=view.on_other_storeys,
    )


def _pose_fields(told: ToldPose) -> Fields:
    pose, in_map = transform_fields(told.pose.T_frame_view), told.session is None
    return fields_of(
        pb.RelocalisedPose,
        told.pose,
        t_map_sensor=pose if in_map else None,
        frame=told.pose.frame if in_map else None,
        map_version=told.map_version,
        t_session_sensor=None if in_map else pose,
        session=told.session,
        covariance=told.pose.covariance.ravel().tolist(),
    )
