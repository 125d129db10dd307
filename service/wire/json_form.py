"""The fields of a message as ProtoJSON, the JSON form that protobuf defines for its messages (decision 0070).

`google.protobuf.json_format` renders messages, not fields, and needs six times as long for a page of loop closures,
most of it for evidence that is JSON already. Here evidence passes through as it is; a test compares the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message

from revisit.service.wire.fields import Fields, descriptor_of

STRUCT = "google.protobuf.Struct"


@dataclass(frozen=True)
class _Rendering:
    """How one field is rendered: `render` is None for JSON values, `absent` makes the value of an absent field."""

    name: str
    render: Callable[[Any], Any] | None
    absent: Callable[[], Any] | None


def json_form(message: type[Message], fields: Mapping[str, Any]) -> Fields:
    """`fields` of a message as ProtoJSON with the proto's field names.

    64-bit integers are strings. A field that is absent is left out where the message can tell absence, else it is 0,
    false, "", [] or the unspecified value. Raises KeyError for a field that the message does not have.
    """
    return _json_form(descriptor_of(message), fields)


def _json_form(descriptor: Descriptor, fields: Mapping[str, Any]) -> Fields:
    renderings = _renderings(descriptor)
    if not fields.keys() <= renderings.keys():
        raise KeyError(f"{descriptor.full_name} has no field {', '.join(fields.keys() - renderings.keys())}")
    answer: Fields = {}
    for name, rendering in renderings.items():
        value = fields.get(name)
        if value is not None:
            answer[name] = value if rendering.render is None else rendering.render(value)
        elif rendering.absent is not None:
            answer[name] = rendering.absent()
    return answer


@cache
def _renderings(descriptor: Descriptor) -> dict[str, _Rendering]:
    return {field.name: _Rendering(field.name, _render(field), _absent(field)) for field in descriptor.fields}


def _render(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    one = _render_one(field)
    if one is None or not field.is_repeated:
        return one
    return lambda values: [one(value) for value in values]


def _render_one(field: FieldDescriptor) -> Callable[[Any], Any] | None:
    match field.cpp_type:
        case FieldDescriptor.CPPTYPE_INT64 | FieldDescriptor.CPPTYPE_UINT64:
            return str
        case FieldDescriptor.CPPTYPE_DOUBLE | FieldDescriptor.CPPTYPE_FLOAT:
            return _number
    if field.message_type is None or field.message_type.full_name == STRUCT:
        return None
    return partial(_json_form, field.message_type)


def _absent(field: FieldDescriptor) -> Callable[[], Any] | None:
    if field.is_repeated:
        return list
    if field.has_presence:
        return None
    if field.enum_type is not None:
        unspecified = field.enum_type.values_by_number[0].name
        return lambda: unspecified
    render, default = _render_one(field), field.default_value
    value = default if render is None else render(default)
    return lambda: value


def _number(value: float) -> float | str:
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
