"""Answers over REST as messages: ProtoJSON to the fields that a message is made of, by the message's own constructor.

`google.protobuf.json_format` reads value by value in Python, a third of the client's cost of a search. It is still the
reference, and reads JSON of any other form; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, TypeVar, cast

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.json_format import ParseDict
from google.protobuf.message import Message
from google.protobuf.struct_pb2 import Struct

M = TypeVar("M", bound=Message)

_INTEGERS = (FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_UINT64)
_FLOATS = (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT)
_STRUCT = Struct.DESCRIPTOR.full_name

Read = Callable[[Any], Any]


def message_of(kind: type[M], answer: Any) -> M:
    """The message of this `kind` from its JSON `answer`; fields of a newer service are ignored.

    Raises ValueError or ParseError for any other JSON.
    """
    if not isinstance(answer, dict):
        raise ValueError(f"a message is an object in JSON, not {type(answer).__name__}")
    try:
        return kind(**_fields(cast(Descriptor, kind.DESCRIPTOR), answer))
    except (TypeError, ValueError, AttributeError, KeyError):
        return ParseDict(answer, kind(), ignore_unknown_fields=True)


def _fields(descriptor: Descriptor, answer: Mapping[str, Any]) -> dict[str, Any]:
    readers, found = _readers(descriptor), dict[str, Any]()
    for name, value in answer.items():
        if value is not None and name in readers:
            read = readers[name]
            found[name] = value if read is None else read(value)
    return found


@cache
def _readers(descriptor: Descriptor) -> dict[str, Read | None]:
    """By the name of a field; None for a value that the constructor takes as it is."""
    return {field.name: _reader(field) for field in descriptor.fields}


def _reader(field: FieldDescriptor) -> Read | None:
    one = _reader_of_one(field)
    if one is None or not field.is_repeated:
        return one
    return lambda values: [one(value) for value in values]


def _reader_of_one(field: FieldDescriptor) -> Read | None:
    if field.cpp_type in _INTEGERS:
        return int
    if field.cpp_type in _FLOATS:
        return float  # of "NaN" and "Infinity", too
    if field.type == FieldDescriptor.TYPE_BYTES:
        return _for_the_reference
    if field.enum_type is not None:
        return {value.name: value.number for value in field.enum_type.values}.__getitem__
    if field.message_type is None:
        return None
    if field.message_type.full_name == _STRUCT:
        return lambda value: ParseDict(value, Struct())
    return partial(_fields, field.message_type)


def _for_the_reference(value: Any) -> Any:
    raise TypeError(f"{type(value).__name__} is read by the reference")
