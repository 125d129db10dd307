"""Resources out of their messages: each field of a dataclass from the field of the message that has its name.

`T_map_submap` is `t_map_submap`. Types say the rest: a (4, 4) matrix out of a Transform, three numbers out of a
Vector3, the name of an enum's value, JSON out of a Struct, a resource or a tuple of them out of messages; None for an
absent field or, of text and numbers that cannot be absent, an empty one. A field that is read in another way says so
with `read_by`.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Any, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.json_format import MessageToDict
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.v1 import geometry_pb2

if TYPE_CHECKING:
    from typing import Self

Json = dict[str, Any]
Matrix4 = NDArray[np.float64]
Read = Callable[[Any], Any]

_READ = "read"


@dataclass(frozen=True)
class Resource:
    """A resource of the service."""

    @classmethod
    def of(cls, message: Any) -> Self:
        """From its message."""
        return cls(**{name: read(message) for name, read in _readers(cast(Any, cls))})


def read_by(read: Read) -> Mapping[str, Read]:
    """The metadata of a field that `read` makes of the whole message."""
    return {_READ: read}


@cache
def _readers(kind: type[Resource]) -> tuple[tuple[str, Read], ...]:
    hints = get_type_hints(kind)
    return tuple((one.name, one.metadata.get(_READ) or _reader(one.name, hints[one.name])) for one in fields(kind))


def _reader(name: str, hint: Any) -> Read:
    """How a field of this type is read of a message; its descriptor is looked at with the first one."""
    source, optional = f"t{name[1:]}" if name.startswith("T_") else name, _is_optional(hint)
    kind = _without_none(hint)
    known: dict[int, Read] = {}

    def read(message: Any) -> Any:
        key = id(message.DESCRIPTOR)
        if key not in known:
            known[key] = _value_reader(message.DESCRIPTOR.fields_by_name[source], kind, optional)
        return known[key](message)

    return read


def _value_reader(of: FieldDescriptor, kind: Any, optional: bool) -> Read:
    name, convert = of.name, _converter(of, kind)
    if of.is_repeated:
        return lambda message: tuple(convert(item) for item in getattr(message, name))
    if not optional:
        return lambda message: convert(getattr(message, name))
    if of.has_presence:
        return lambda message: convert(getattr(message, name)) if message.HasField(name) else None
    return lambda message: convert(getattr(message, name)) if getattr(message, name) else None


def _converter(of: FieldDescriptor, kind: Any) -> Read:
    if of.enum_type is not None:
        values = cast(Mapping[int, Any], of.enum_type.values_by_number)
        return lambda number: str(values[number].name) if number in values else str(number)
    if of.message_type is None:
        return _as_it_is
    known: dict[str, Read] = {"Transform": matrix, "Vector3": vector_of, "Struct": MessageToDict}
    item = get_args(kind)[0] if of.is_repeated else kind
    return known.get(of.message_type.name) or cast(Read, item.of)


def _as_it_is(value: Any) -> Any:
    return value


def _is_optional(hint: Any) -> bool:
    return get_origin(hint) in (Union, types.UnionType) and type(None) in get_args(hint)


def _without_none(hint: Any) -> Any:
    if not _is_optional(hint):
        return hint
    (kind,) = (one for one in get_args(hint) if one is not type(None))
    return kind


def matrix(message: geometry_pb2.Transform) -> Matrix4:
    """The (4, 4) matrix of a Transform."""
    q = message.rotation
    return se3.from_quaternion((q.x, q.y, q.z, q.w), vector_of(message.translation))


def vector_of(message: geometry_pb2.Vector3) -> tuple[float, float, float]:
    """The numbers of a Vector3."""
    return message.x, message.y, message.z


def covariance_of(message: Any) -> Matrix4:
    """The (6, 6) covariance of a message, NaN where the graph does not tell it."""
    if not message.covariance:
        return np.full((6, 6), np.nan)
    return np.array(message.covariance, dtype=np.float64).reshape(6, 6)
