"""The form of request messages over HTTP: how each field is spelled in a path, a query string and a JSON body.

Names and types come from the descriptors of `proto/revisit/v1`, bounds from `request_fields`. Three kinds of fields are
spelled in a way of their own: a transform is text, `T_map_source=x,y,z,qx,qy,qz,qw`; a point is `x,y,z`, and many are
one list of numbers; a resource that the path implies is named by its id, `robot_id`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated, Any, Literal, TypeVar, cast

from fastapi import Query
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message
from pydantic import Field, create_model

from revisit.api.calls import Call, Form
from revisit.api.http_form import is_point, is_transform, spelling
from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.rest.bodies import parse_numbers
from revisit.service.rest.parameters import POINT_HELP, POSE_HELP, Id
from revisit.service.rest.paths import VERSION_ID, resource_in
from revisit.service.rest.request_fields import (
    BOUNDS,
    DEFAULTS,
    POINT_CHARACTERS,
    POSE_CHARACTERS,
    REQUIRED,
    TEXTS,
)
from revisit.service.rest.schemas import IN_DIGITS, Coordinate, Request, bounds, length
from revisit.service.wire import names
from revisit.service.wire.fields import descriptor_of
from revisit.v1.comments import COMMENTS

Values = Mapping[str, Any]
Route = TypeVar("Route", bound=Callable[..., Any])


@dataclass(frozen=True)
class Spelled:
    """A field of a request as HTTP has it: name, type, default (`...`: required), and how its value is read."""

    field: str
    name: str
    kind: Any
    default: Any
    read: Callable[[Any], Any] | None = None
    """From the value to the constructor's argument; None where they are the same."""
    resource: str = ""
    """The name that an id stands for, of `{parent}` and `{id}`."""

    def value(self, sent: Any, parent: str) -> Any:
        """The arguments of the message's constructor. Raises BadField."""
        if self.resource:
            return self.resource.format(parent=parent, id=sent)
        return sent if self.read is None else self.read(sent)


@dataclass(frozen=True)
class RequestForm:
    """How the request of a call is sent: `{name}` or `{parent}` in the path, the rest in the query or in the body."""

    call: Call
    named: str
    """The field that the path names, "" where it names none."""
    pattern: str
    ids: tuple[str, ...]
    query: tuple[Spelled, ...]
    body: tuple[Spelled, ...]
    model: type[Request] | None

    def _parameters(self) -> list[inspect.Parameter]:
        kind, ids = inspect.Parameter.KEYWORD_ONLY, [(name, Id, ...) for name in self.ids]
        asked = [(one.name, one.kind, one.default) for one in self.query]
        return [
            inspect.Parameter(name, kind, annotation=of, default=inspect.Parameter.empty if default is ... else default)
            for name, of, default in (*ids, *asked)
        ]

    def asked_by(self, **others: Any) -> Callable[[Route], Route]:
        """Gives a route the parameters of the request beside `others`, annotations by name."""
        kind = inspect.Parameter.KEYWORD_ONLY
        more = [inspect.Parameter(name, kind, annotation=annotation) for name, annotation in others.items()]

        def asked(route: Route) -> Route:
            route.__signature__ = inspect.Signature([*self._parameters(), *more])  # type: ignore[attr-defined]
            return route  # whose signature FastAPI reads

        return asked

    def message(self, values: Values, body: Request | None) -> Message:
        """The request of these values. Raises BadField."""
        if VERSION_ID in self.ids:
            # Errors name the version, not the name that the path becomes.
            names.version_number(values[VERSION_ID])
        ids = iter(self.ids)
        name = "/".join(values[next(ids)] if part == "*" else part for part in self.pattern.split("/"))
        found: dict[str, Any] = {self.named: name} if self.named else {}
        sent = ((self.query, values.get), (self.body, partial(_attribute, body)))
        for spelled, value_of in sent:
            for one in spelled:
                value = value_of(one.name)
                if value is not None:
                    found[one.field] = one.value(value, name)
        return self.call.request(**found)


def _attribute(body: Request | None, name: str) -> Any:
    return getattr(body, name)


@cache
def form_of(call: Call, without: frozenset[str] = frozenset()) -> RequestForm:
    """The form of the request of a call that HTTP has, but for the fields `without`, which have a form of their own."""
    named, pattern, ids = resource_in(call)
    fields = [field for field in descriptor_of(call.request).fields if field.name not in {named, *without}]
    in_body = call.row.http.startswith("POST") and call.row.form is Form.MESSAGE and bool(fields)
    spelled = tuple(_spelled(field, in_body) for field in fields)
    model = _model(descriptor_of(call.request), spelled, call.row.json_bytes) if in_body else None
    query, body = ((), spelled) if in_body else (spelled, ())
    return RequestForm(call, named, pattern, ids, query, body, model)


def _spelled(field: FieldDescriptor, in_body: bool) -> Spelled:
    name, resource = spelling(field)
    read: Callable[[Any], Any] | None = None
    by_id = bool(resource)
    if is_transform(field):
        read = partial(_transform, name)
    elif is_point(field):
        read = _points if field.is_repeated else partial(_point, field.name)
    elif _is_part(field):
        read = partial(_parts if field.is_repeated else _part_fields, cast(Descriptor, field.message_type))
    return Spelled(field.name, name, _kind(field, by_id, in_body), _default(field, by_id), read, resource)


def _default(field: FieldDescriptor, by_id: bool) -> Any:
    if field.name in REQUIRED and not by_id:
        return ...
    for key in (".".join(field.full_name.split(".")[-2:]), field.name):
        if key in DEFAULTS:
            return DEFAULTS[key]
    if _is_part(field):
        return _part(field.message_type)()
    if by_id or field.has_presence or (field.enum_type is not None and not field.is_repeated):
        return None
    return [] if field.is_repeated else field.default_value


def _kind(field: FieldDescriptor, by_id: bool, in_body: bool) -> Any:
    """The annotated type of a field, which allows None where that is its default."""
    kind, details = _type(field), _details(field, by_id)
    nullable = _default(field, by_id) is None
    if in_body:
        return Annotated[kind | None, Field(**details)] if nullable else Annotated[kind, Field(**details)]
    digits = (IN_DIGITS,) if kind is int else ()
    return Annotated[(kind | None if nullable else kind, Query(**details), *digits)]


def _type(field: FieldDescriptor) -> Any:
    one = _type_of_one(field)
    if field.is_repeated and field.name in BOUNDS:
        one = Annotated[one, Field(**bounds(BOUNDS[field.name]))]
    return list[one] if field.is_repeated and one is not _MANY else one  # type: ignore[valid-type]  # made at run time


_MANY = list[Coordinate]


def _type_of_one(field: FieldDescriptor) -> Any:
    if field.enum_type is not None:
        return Literal[_names(field.enum_type)]
    if is_point(field) and field.is_repeated:
        return _MANY
    if is_transform(field) or is_point(field):
        return str
    return _part(field.message_type) if _is_part(field) else _SCALARS[field.cpp_type]


@cache
def _part(descriptor: Descriptor) -> type[Request]:
    """The model of a message within a request."""
    return _model(descriptor, _spelled_parts(descriptor), 0)


@cache
def _spelled_parts(descriptor: Descriptor) -> tuple[Spelled, ...]:
    """The fields of a message within a request as HTTP has them."""
    return tuple(_spelled(field, True) for field in descriptor.fields)


_SCALARS: dict[int, type] = {
    FieldDescriptor.CPPTYPE_STRING: str,
    FieldDescriptor.CPPTYPE_BOOL: bool,
    FieldDescriptor.CPPTYPE_DOUBLE: float,
    FieldDescriptor.CPPTYPE_FLOAT: float,
    FieldDescriptor.CPPTYPE_INT32: int,
    FieldDescriptor.CPPTYPE_UINT32: int,
    FieldDescriptor.CPPTYPE_INT64: int,
    FieldDescriptor.CPPTYPE_UINT64: int,
}


def _details(field: FieldDescriptor, by_id: bool) -> dict[str, Any]:
    """Bounds and description of a field."""
    if field.name in BOUNDS and not field.is_repeated:
        return _described(field, bounds(BOUNDS[field.name]))
    if is_transform(field):
        return _described(field, {"max_length": POSE_CHARACTERS}, POSE_HELP)
    if is_point(field):
        point = _described(field, {"max_length": POINT_CHARACTERS}, POINT_HELP)
        return length(limits.DISTANCE_POINTS, 3) if field.is_repeated else point
    if field.enum_type is not None and field.is_repeated:
        return _described(field, {"max_length": len(_names(field.enum_type))})
    return TEXTS[field.name] if by_id else _described(field, TEXTS.get(field.name, {}))


def _described(field: FieldDescriptor, details: dict[str, Any], spelled: str = "") -> dict[str, Any]:
    comment = " ".join(filter(None, (spelled, COMMENTS.get(field.full_name))))
    return {**details, "description": comment} if comment else details


def _model(descriptor: Descriptor, spelled: tuple[Spelled, ...], json_bytes: int) -> type[Request]:
    """A strict model of a message."""
    fields: Any = {one.name: (one.kind, one.default) for one in spelled}
    comment = COMMENTS.get(descriptor.full_name)
    model = create_model(descriptor.name, __base__=Request, __doc__=comment, **fields)
    if json_bytes:
        model.most_bytes = json_bytes
    return model


def _names(enum: EnumDescriptor) -> tuple[str, ...]:
    return tuple(value.name for value in enum.values if value.number)


def _is_part(field: FieldDescriptor) -> bool:
    """Whether a field is a message that is spelled as one."""
    return field.message_type is not None and not (is_transform(field) or is_point(field))


def _transform(name: str, value: str) -> dict[str, Any]:
    numbers = parse_numbers(value, 7, name, "x,y,z,qx,qy,qz,qw")
    return {
        "translation": dict(zip("xyz", numbers[:3], strict=True)),
        "rotation": dict(zip("xyzw", numbers[3:], strict=True)),
    }


def _point(name: str, value: str) -> dict[str, float]:
    return dict(zip("xyz", parse_numbers(value, 3, name, "x,y,z"), strict=True))


def _points(value: list[float]) -> list[dict[str, float]]:
    if len(value) % 3:
        raise BadField("points_m must hold x, y and z of each point", field="points_m")
    return [dict(zip("xyz", value[i : i + 3], strict=True)) for i in range(0, len(value), 3)]


def _part_fields(descriptor: Descriptor, value: Request) -> dict[str, Any]:
    """The fields of a message within a request."""
    sent = ((one, getattr(value, one.name)) for one in _spelled_parts(descriptor))
    return {one.field: one.value(each, "") for one, each in sent if each is not None}


def _parts(descriptor: Descriptor, values: list[Request]) -> list[dict[str, Any]]:
    return [_part_fields(descriptor, value) for value in values]
