"""Fields of requests that HTTP spells in a way of its own: transforms, points, and resources that the path implies."""

from __future__ import annotations

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from revisit.v1 import geometry_pb2

BY_ID = {
    "CreateSessionRequest.robot": ("robot_id", "robots/{id}"),
    "CreateWebhookRequest.map": ("map_id", "maps/{id}"),
    "ListLoopClosuresRequest.session": ("session_id", "{parent}/sessions/{id}"),
    "SearchSubmapsRequest.exclude_session": ("exclude_session", "{parent}/sessions/{id}"),
    "SearchSubmapsRequest.only_session": ("only_session", "{parent}/sessions/{id}"),
    "LocalizeRequest.exclude_session": ("exclude_session", "{parent}/sessions/{id}"),
    "LocalizeRequest.only_session": ("only_session", "{parent}/sessions/{id}"),
}
"""Resources that are named by their id: the field over HTTP, and the name that it stands for."""


def spelling(field: FieldDescriptor) -> tuple[str, str]:
    """The name of a field over HTTP; where it holds the id of a resource, also the form of that resource's name."""
    own = f"T{field.name[1:]}" if is_transform(field) else field.name
    return BY_ID.get(".".join(field.full_name.split(".")[-2:]), (own, ""))


def is_transform(field: FieldDescriptor) -> bool:
    """Whether a field is a Transform: text over HTTP, `T_map_source=x,y,z,qx,qy,qz,qw`."""
    return _is(field, geometry_pb2.Transform)


def is_point(field: FieldDescriptor) -> bool:
    """Whether a field is a Vector3, or many: numbers over HTTP, in a query string `x,y,z`."""
    return _is(field, geometry_pb2.Vector3)


def _is(field: FieldDescriptor, message: type[Message]) -> bool:
    return field.message_type is not None and field.message_type.full_name == message.DESCRIPTOR.full_name
