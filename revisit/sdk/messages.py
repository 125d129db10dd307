"""The messages of `proto/revisit/v1` that both transports send and receive."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from typing import Any, TypeVar

from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import Message

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.sdk.clouds import Cloud, PointsLike, encoded
from revisit.sdk.errors import ErrorDetails, InvalidArgument
from revisit.sdk.reading import Json
from revisit.v1 import cloud_pb2

M = TypeVar("M", bound=Message)


def request_of(kind: type[M], fields: Mapping[str, Any]) -> M:
    """A request with `fields`, of which those that are None are left out.

    Raises InvalidArgument (BAD_FIELD) for an unknown field and for a value that its type cannot hold.
    """
    request = kind()
    for name, value in fields.items():
        if value is None:
            continue
        if isinstance(value, Message):
            getattr(request, name).CopyFrom(value)
            continue
        spelled = b64encode(value).decode() if isinstance(value, bytes) else value
        try:
            ParseDict({name: spelled}, request)
        except (ParseError, TypeError, ValueError) as error:
            reason = "is unknown" if name not in request.DESCRIPTOR.fields_by_name else "has an unusable value"
            details = ErrorDetails("INVALID_ARGUMENT", "BAD_FIELD", f"{name} {reason}", field=name)
            raise InvalidArgument(details) from error
    return request


def cloud_message(cloud: Cloud) -> cloud_pb2.Cloud:
    """A cloud as a message."""
    return cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=cloud.content_type, data=cloud.data))


def cloud_of(points: PointsLike) -> cloud_pb2.Cloud:
    """Points as they are sent."""
    return cloud_message(encoded(points))


def pose_json(T_target_source: Any) -> Json:
    """A (4, 4) or (3, 4) transform as the JSON of a Transform. Raises core.errors.BadTransform."""
    transform = se3.validated(T_target_source)
    translation = dict(zip("xyz", (float(v) for v in transform[:3, 3]), strict=True))
    rotation = dict(zip("xyzw", (float(v) for v in se3.to_quaternion(transform)), strict=True))
    return {"translation": translation, "rotation": rotation}


def pose_message(transform: Any, field: str, *, required: bool = False) -> Json | None:
    """The JSON of a Transform; None where there is none and none is `required`. Raises InvalidArgument for `field`."""
    if transform is None and not required:
        return None
    try:
        return pose_json(transform)
    except RevisitError as error:
        details = ErrorDetails("INVALID_ARGUMENT", error.code.value, error.message, field=field)
        raise InvalidArgument(details) from error


def vector(position_m: Any) -> Any:
    """Three numbers as the JSON of a Vector3; anything else as it is, to be refused by `request_of`."""
    try:
        x, y, z = (float(value) for value in position_m)
    except (TypeError, ValueError):
        return position_m
    return {"x": x, "y": y, "z": z}
