"""The messages of `proto/revisit/v1` that both transports send and receive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import Message

from revisit.sdk.clouds import Cloud
from revisit.sdk.errors import ErrorDetails, InvalidArgument
from revisit.v1 import (
    cloud_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    webhook_pb2,
)

M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Collection:
    """Resources of one kind: their message, the name of the field that holds one, and the page of a list of them."""

    resource: type[Message]
    field: str
    page: type[Message]


COLLECTIONS = {
    "maps": Collection(map_pb2.Map, "map", map_pb2.ListMapsResponse),
    "robots": Collection(robot_pb2.Robot, "robot", robot_pb2.ListRobotsResponse),
    "sessions": Collection(session_pb2.Session, "session", session_pb2.ListSessionsResponse),
    "submaps": Collection(submap_pb2.Submap, "submap", submap_pb2.ListSubmapsResponse),
    "events": Collection(
        loop_closure_pb2.LoopClosureEvent, "loop_closure_event", loop_closure_pb2.ListLoopClosureEventsResponse
    ),
    "versions": Collection(mapping_pb2.MapVersion, "map_version", mapping_pb2.ListMapVersionsResponse),
    "merges": Collection(mapping_pb2.MapMerge, "map_merge", mapping_pb2.ListMapMergesResponse),
    "tiles": Collection(map_tile_pb2.MapTile, "map_tile", map_tile_pb2.ListMapTilesResponse),
    "files": Collection(map_file_pb2.MapFile, "map_file", map_file_pb2.ListMapFilesResponse),
    "poses": Collection(mapping_pb2.SubmapPose, "submap_pose", mapping_pb2.ListSubmapPosesResponse),
    "operations": Collection(operation_pb2.Operation, "operation", operation_pb2.ListOperationsResponse),
    "webhooks": Collection(webhook_pb2.Webhook, "webhook", webhook_pb2.ListWebhooksResponse),
    "loopClosures": Collection(loop_closure_pb2.LoopClosure, "loop_closure", loop_closure_pb2.ListLoopClosuresResponse),
}
"""By the name that the collection has in resource names and paths."""


def collection_of(name: str) -> str:
    """The collection that a resource is in, by its name."""
    parts = name.split("/")
    return parts[-2] if len(parts) > 1 and parts[-2] in COLLECTIONS else "maps"


def request_of(kind: type[M], fields: Mapping[str, Any]) -> M:
    """A request with `fields`, of which those that are None are left out.

    Raises InvalidArgument (BAD_FIELD) for an unknown field and for a value that its type cannot hold.
    """
    request = kind()
    for name, value in fields.items():
        if value is None:
            continue
        try:
            ParseDict({name: value}, request)
        except (ParseError, TypeError, ValueError) as error:
            reason = "is unknown" if name not in request.DESCRIPTOR.fields_by_name else "has an unusable value"
            details = ErrorDetails("INVALID_ARGUMENT", "BAD_FIELD", f"{name} {reason}", field=name)
            raise InvalidArgument(details) from error
    return request


def cloud_message(cloud: Cloud) -> cloud_pb2.Cloud:
    """A cloud as a message."""
    return cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=cloud.content_type, data=cloud.data))


def vector(position_m: Any) -> Any:
    """Three numbers as the JSON of a Vector3; anything else as it is, to be refused by `request_of`."""
    try:
        x, y, z = (float(value) for value in position_m)
    except (TypeError, ValueError):
        return position_m
    return {"x": x, "y": y, "z": z}
