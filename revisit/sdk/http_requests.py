"""Requests as HTTP sends them: path, query string and body out of a message and the row of its call."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from revisit.api.calls import NAMED, Call
from revisit.api.http_form import is_point, is_transform, spelling
from revisit.formats.pictures import JPEG, JPEG_BEGIN, PNG
from revisit.sdk.reading import Json
from revisit.v1 import cloud_pb2, geometry_pb2

SENT_ALWAYS = frozenset({"stamp_ns", "submap_id"})
"""Parameters that the service must be given, also where they are 0 or empty."""

NOT_FIELDS = frozenset({"cloud", "image", "place_descriptor"})
"""The body itself, or several of its fields."""


@dataclass(frozen=True)
class HttpRequest:
    """Method and path of a request, and the other arguments as httpx takes them."""

    verb: str
    path: str
    arguments: Json = field(default_factory=dict)


def http_request(call: Call, request: Any) -> HttpRequest:
    """The request of a call that HTTP has."""
    verb, _, rule = call.row.http.partition(" ")
    path = NAMED.sub(lambda found: str(getattr(request, found["field"])), rule)
    named = found["field"] if (found := NAMED.search(rule)) else ""
    if "cloud" in request.DESCRIPTOR.fields_by_name and request.HasField("cloud"):
        return HttpRequest(verb, path, cloud_arguments(request.cloud, dict(_spelled(request, named))))
    if "image" in request.DESCRIPTOR.fields_by_name:
        return HttpRequest(verb, path, _image_arguments(request, dict(_spelled(request, named))))
    if verb == "POST":
        has_body = any(one.name != named for one in request.DESCRIPTOR.fields)
        return HttpRequest(verb, path, {"json": _body(request, named)} if has_body else {})
    return HttpRequest(verb, path, {"params": dict(_spelled(request, named))})


def cloud_arguments(cloud: cloud_pb2.Cloud, params: Json) -> Json:
    """The arguments of a request with a cloud as its body."""
    headers = {"content-type": cloud.encoded.content_type}
    return {"content": cloud.encoded.data, "params": params, "headers": headers}


def _image_arguments(request: Any, params: Json) -> Json:
    """The arguments of a request with a picture as its body, and pins as texts."""
    pins = [",".join(map(repr, (pin.pixel_x, pin.pixel_y, pin.x_m, pin.y_m))) for pin in request.pins]
    # Anything else is the service's to refuse.
    headers = {"content-type": JPEG if request.image.startswith(JPEG_BEGIN) else PNG}
    return {"content": request.image, "params": {**params, "pins": pins}, "headers": headers}


def pose_text(pose: geometry_pb2.Transform) -> str:
    """x,y,z,qx,qy,qz,qw."""
    t, q = pose.translation, pose.rotation
    return ",".join(repr(number) for number in (t.x, t.y, t.z, q.x, q.y, q.z, q.w))


def _body(request: Any, named: str) -> Json:
    body = dict(_spelled(request, named))
    if "place_descriptor" in request.DESCRIPTOR.fields_by_name and request.HasField("place_descriptor"):
        body["descriptor"] = list(request.place_descriptor.vector)
        body["model_version"] = request.place_descriptor.model_version
    return body


def _spelled(request: Message, named: str) -> Iterator[tuple[str, Any]]:
    """Names and values over HTTP of the fields that are set."""
    for one, value in request.ListFields():
        if one.name == named or one.name in NOT_FIELDS:
            continue
        name, resource = spelling(one)
        yield name, value.rpartition("/")[2] if resource else _value(one, value)
    for required in request.DESCRIPTOR.fields:
        if required.name in SENT_ALWAYS:
            yield required.name, getattr(request, required.name)


def _value(one: FieldDescriptor, value: Any) -> Any:
    """A value as query strings and the JSON of requests have it, in which 64-bit integers are numbers."""
    if is_transform(one):
        return pose_text(value)
    if is_point(one):
        return [number for point in value for number in _numbers(point)] if one.is_repeated else _point_text(value)
    if one.is_repeated:
        return [_one(one, item) for item in value]
    return _one(one, value)


def _numbers(point: geometry_pb2.Vector3) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _point_text(point: geometry_pb2.Vector3) -> str:
    """x,y,z."""
    return ",".join(map(repr, _numbers(point)))


def _one(one: FieldDescriptor, value: Any) -> Any:
    if one.message_type is not None:
        return {spelling(part)[0]: _value(part, item) for part, item in value.ListFields()}
    return value if one.enum_type is None else one.enum_type.values_by_number[value].name
