"""Conversations and their answers as JSON: from the gateway that keeps them to the worker that goes on, and back."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.relocalisation import (
    ConversationState,
    Hypothesis,
    PossiblePose,
    RelocalisationAnswer,
    RelocalisationState,
    TellsApart,
    UnknownReason,
)
from revisit.core.relocalisation.view_window import ViewCloud

Json = dict[str, Any]


@dataclass(frozen=True)
class ToldPose:
    """A possible pose of the newest view as a client sees it.

    Where the map has a frame for it, T_frame_view (4, 4) is T_map_view by `map_version` and `session` is None; else it
    is in the odometry frame of `session`, a resource name.
    """

    pose: PossiblePose
    session: str | None
    map_version: int | None


@dataclass(frozen=True)
class ViewAnswer:
    """The answer to a view, its poses as a client sees them, and how many submaps were left out for their storey."""

    answer: RelocalisationAnswer
    poses: tuple[ToldPose, ...]
    on_other_storeys: int = 0


def view_to_json(view: ViewCloud, travelled_m: float) -> Json:
    """All of a view but its points, for a job's payload."""
    return {
        "ends": list(view.ends),
        "origins": view.origins.tolist(),
        "T_odom_view": pose_row(view.T_odom_view),
        "travelled_m": travelled_m,
    }


def view_from_json(data: Json, points: np.ndarray[Any, np.dtype[np.float32]]) -> ViewCloud:
    """The inverse of `view_to_json`, with the points (n, 3)."""
    origins = np.array(data["origins"], dtype=np.float32)
    return ViewCloud(points, tuple(data["ends"]), origins, pose_matrix(tuple(data["T_odom_view"])))


def state_to_json(state: ConversationState) -> Json:
    """For a payload and a result."""
    return {**vars(state), "hypotheses": [_hypothesis_to_json(one) for one in state.hypotheses]}


def state_from_json(data: Json) -> ConversationState:
    """The inverse of `state_to_json`."""
    return ConversationState(**{**data, "hypotheses": tuple(_hypothesis_from_json(one) for one in data["hypotheses"])})


def answer_to_json(view: ViewAnswer) -> Json:
    """For an operation's result."""
    answer = view.answer
    return {
        "state": answer.state.value,
        "reason": None if answer.reason is None else answer.reason.value,
        "none_of_them": answer.none_of_them,
        "travelled_m": answer.travelled_m,
        "tells_apart": None if answer.tells_apart is None else asdict(answer.tells_apart),
        "poses": [_pose_to_json(one) for one in view.poses],
        "on_other_storeys": view.on_other_storeys,
    }


def answer_from_json(data: Json) -> ViewAnswer:
    """The inverse of `answer_to_json`."""
    poses = tuple(_pose_from_json(one) for one in data["poses"])
    answer = RelocalisationAnswer(
        RelocalisationState(data["state"]),
        tuple(one.pose for one in poses),
        data["none_of_them"],
        data["travelled_m"],
        None if data["reason"] is None else UnknownReason(data["reason"]),
        None if data["tells_apart"] is None else TellsApart(**data["tells_apart"]),
    )
    return ViewAnswer(answer, poses, data["on_other_storeys"])


def _hypothesis_to_json(one: Hypothesis) -> Json:
    return {**vars(one), "T_frame_odom": pose_row(one.T_frame_odom), "covariance": one.covariance.ravel().tolist()}


def _hypothesis_from_json(data: Json) -> Hypothesis:
    pose, covariance = pose_matrix(tuple(data["T_frame_odom"])), np.array(data["covariance"]).reshape(6, 6)
    return Hypothesis(**{**data, "T_frame_odom": pose, "covariance": covariance})


def _pose_to_json(told: ToldPose) -> Json:
    one = told.pose
    pose = {**vars(one), "T_frame_view": pose_row(one.T_frame_view), "covariance": one.covariance.ravel().tolist()}
    return {"pose": pose, "session": told.session, "map_version": told.map_version}


def _pose_from_json(data: Json) -> ToldPose:
    one = data["pose"]
    pose, covariance = pose_matrix(tuple(one["T_frame_view"])), np.array(one["covariance"]).reshape(6, 6)
    told = PossiblePose(**{**one, "T_frame_view": pose, "covariance": covariance})
    return ToldPose(told, data["session"], data["map_version"])
