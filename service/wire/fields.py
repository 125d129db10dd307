"""Views of the use cases to the fields of their messages in `proto/revisit/v1`.

A dict by field name stands for a message: a field that is None is absent. gRPC gives the dict to the message's
constructor, REST renders it with `json_form`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import cache
from operator import attrgetter
from typing import Any, TypeAlias, cast

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.service.domain.records import JobRecord, Pose, SubmapRecord
from revisit.service.features.graph.map_frames import MapPose, matrix_of
from revisit.v1 import geometry_pb2

Fields: TypeAlias = dict[str, Any]

_TRANSFORM = geometry_pb2.Transform.DESCRIPTOR.full_name
_VECTOR = geometry_pb2.Vector3.DESCRIPTOR.full_name
_STRUCT = "google.protobuf.Struct"

Plan: TypeAlias = tuple[tuple[str, Callable[[Any], Any], Callable[[Any], Any] | None], ...]


def fields_of(message: type[Message], view: Any, **own: Any) -> Fields:
    """The fields of a message: `own`, and every other one as the view has it under the same name (`T_...` for `t_...`).

    Raises AttributeError for a field that neither has.
    """
    fields = dict(own)
    for name, read, convert in _plan(descriptor_of(message), tuple(own)):
        value = read(view)
        fields[name] = value if convert is None or value is None else convert(value)
    return fields


@cache
def _plan(descriptor: Descriptor, own: tuple[str, ...]) -> Plan:
    """Name, reader and converter of each field but `own`."""
    rest = [field for field in descriptor.fields if field.name not in own]
    return tuple((field.name, attrgetter(_attribute(field)), _converter(field)) for field in rest)


def descriptor_of(message: type[Message]) -> Descriptor:
    """The message's type; its stubs name two classes of descriptors."""
    return cast(Descriptor, message.DESCRIPTOR)


def _attribute(field: FieldDescriptor) -> str:
    """How views name a field: a transform says its frames, `T_map_submap`."""
    return f"T{field.name[1:]}" if _message_name(field) == _TRANSFORM else field.name


def _converter(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    one = _converter_of_one(field)
    if not field.is_repeated:
        return one
    return list if one is None else lambda values: [one(value) for value in values]


def _converter_of_one(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    if field.enum_type is not None:
        return str
    known = {_TRANSFORM: transform_fields, _VECTOR: vector_fields, _STRUCT: None, "": None}
    return known.get(_message_name(field), _part)


def _part(value: Any) -> Any:
    return value if isinstance(value, dict) else asdict(value)


def _message_name(field: FieldDescriptor) -> str:
    return "" if field.message_type is None else str(field.message_type.full_name)


def vector_fields(values: Iterable[float]) -> Fields:
    """The fields of a Vector3."""
    x, y, z = (float(value) for value in values)
    return {"x": x, "y": y, "z": z}


def geodetic_fields(position: Iterable[float]) -> Fields:
    """The fields of a GeodeticPosition."""
    latitude_deg, longitude_deg, altitude_m = position
    return {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "altitude_m": altitude_m}


def transform_fields(T_target_source: Matrix4 | Pose) -> Fields:
    """The fields of a Transform, from a (4, 4) matrix or the 16 numbers of a row."""
    T = np.asarray(T_target_source, dtype=np.float64).reshape(4, 4)
    x, y, z, w = se3.to_quaternion(T).tolist()
    return {"translation": vector_fields(T[:3, 3]), "rotation": {"x": x, "y": y, "z": z, "w": w}}


def fields_in_map(field: str, pose: MapPose | None) -> Fields:
    """A pose in the map as the three fields that tell of it; None where there is none."""
    T_map = matrix_of(pose)
    placed = None if T_map is None else transform_fields(T_map)
    return {
        field: placed,
        "frame": None if pose is None else pose.frame,
        "map_version": None if pose is None else pose.map_version,
    }


def failure_fields(record: JobRecord | SubmapRecord) -> Fields | None:
    """The fields of a Failure; None where the record has none."""
    code = record.failure_code
    return None if code is None else {"reason": code, "message": record.failure_message or ""}


def covariance_numbers(covariance: NDArray[np.float32]) -> list[float]:
    """The numbers of a covariance; none where the graph does not tell them."""
    return covariance.ravel().tolist() if np.isfinite(covariance).all() else []


def resource_name(collection: str, resource_id: str | None) -> str | None:
    """`robots/rover`; None where there is no id."""
    return None if resource_id is None else f"{collection}/{resource_id}"
