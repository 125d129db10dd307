"""The messages of the proto files as OpenAPI schemas, described by the files' comments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message

from revisit.service.wire.fields import descriptor_of
from revisit.service.wire.json_form import STRUCT
from revisit.v1.comments import COMMENTS

Schema = dict[str, Any]

_INTEGER_TEXT = {"type": "string", "pattern": "^-?[0-9]{1,20}$"}
_SCALARS: dict[int, Schema] = {
    FieldDescriptor.CPPTYPE_INT32: {"type": "integer", "format": "int32"},
    FieldDescriptor.CPPTYPE_UINT32: {"type": "integer", "format": "uint32", "minimum": 0},
    FieldDescriptor.CPPTYPE_INT64: {**_INTEGER_TEXT, "format": "int64"},
    FieldDescriptor.CPPTYPE_UINT64: {**_INTEGER_TEXT, "format": "uint64"},
    FieldDescriptor.CPPTYPE_DOUBLE: {"type": "number", "format": "double"},
    FieldDescriptor.CPPTYPE_FLOAT: {"type": "number", "format": "float"},
    FieldDescriptor.CPPTYPE_BOOL: {"type": "boolean"},
    FieldDescriptor.CPPTYPE_STRING: {"type": "string"},
}


def reference(message: type[Message]) -> Schema:
    """The schema that stands for a message where it is used."""
    return _reference(descriptor_of(message))


def schemas(messages: Iterable[type[Message]]) -> dict[str, Schema]:
    """The schemas of `messages` and of every message within them, by name."""
    found = {part.name: part for message in messages for part in _with_parts(descriptor_of(message))}
    return {name: _of_message(found[name]) for name in sorted(found)}


def _reference(descriptor: Descriptor) -> Schema:
    return {"$ref": f"#/components/schemas/{descriptor.name}"}


def _with_parts(descriptor: Descriptor) -> Iterator[Descriptor]:
    if descriptor.full_name != STRUCT:
        yield descriptor
        for field in descriptor.fields:
            if field.message_type is not None:
                yield from _with_parts(field.message_type)


def _of_message(descriptor: Descriptor) -> Schema:
    required = [field.name for field in descriptor.fields if field.is_repeated or not field.has_presence]
    schema: Schema = {
        "type": "object",
        "title": descriptor.name,
        "properties": {field.name: _of_field(field) for field in descriptor.fields},
    }
    return _described(descriptor.full_name, {**schema, **({"required": required} if required else {})})


def _of_field(field: FieldDescriptor) -> Schema:
    one = _of_value(field)
    return _described(field.full_name, {"type": "array", "items": one} if field.is_repeated else one)


def _of_value(field: FieldDescriptor) -> Schema:
    if field.enum_type is not None:
        return _of_enum(field.enum_type)
    if field.message_type is None:
        return _SCALARS[field.cpp_type]
    if field.message_type.full_name == STRUCT:
        return {"type": "object", "additionalProperties": True}
    return _reference(field.message_type)


def _of_enum(enum: EnumDescriptor) -> Schema:
    return {"type": "string", "enum": [value.name for value in enum.values if value.number != 0]}


def _described(full_name: str, schema: Schema) -> Schema:
    return {**schema, "description": COMMENTS[full_name]} if full_name in COMMENTS else schema
