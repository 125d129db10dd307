"""Request bodies: JSON read strictly, clouds with their transport compression removed within bounds."""

from __future__ import annotations

import asyncio
import json
import re
from functools import cache, partial
from typing import Any, TypeVar

from fastapi import Depends
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect, Request

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.formats import MEDIA_TYPES
from revisit.service.capacity.admission import Admission
from revisit.service.capacity.in_flight import Turns
from revisit.service.capacity.limits import JSON_POINTS_A_BYTE
from revisit.service.domain.callers import current_tenant
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.rest.errors import bad_field
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.schemas import Request as Body

SHORT_JSON_BYTES = 16 * 2**10
"""A longer body waits for its turn, one of each tenant at a time, and is parsed beside the event loop."""

SchemaT = TypeVar("SchemaT", bound=Body)

# Ends with the text where a string does not, and gives nothing back: else one without an end is tried at each quote.
_STRING = re.compile(r'"(?:[^"\\]++|\\.)*+"?', re.DOTALL)
# A number beyond 1e308 has an exponent of three digits, or very many digits: else each need not be looked at.
_MAYBE_HUGE = re.compile(r"[eE]\+?\d{3}|\d{200}")
_BRACKET = re.compile(r"[\[\]{}]")

ANY_BINARY = {"schema": {"type": "string", "format": "binary"}}

CLOUD_CONTENT = dict.fromkeys(MEDIA_TYPES, ANY_BINARY)

CLOUD_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "A point cloud, optionally with Content-Encoding gzip or zstd.",
        "content": CLOUD_CONTENT,
    }
}


def json_body(schema: type[SchemaT]) -> Any:
    """A dependency that reads the body as strict JSON of `schema`."""

    async def read(request: Request) -> SchemaT:
        return await read_json(request, schema)

    return Depends(read)


@cache
def describe_json(schema: type[BaseModel]) -> dict[str, Any]:
    """The OpenAPI part for a body read by `json_body`."""
    content = {"application/json": {"schema": schema.model_json_schema()}}
    return {"requestBody": {"required": True, "content": content}}


async def read_json(request: Request, schema: type[SchemaT]) -> SchemaT:
    """The body of an `application/json` request, which is charged to the rate limits, refused or not.

    Raises UnsupportedEncoding, TooLarge, RateLimited, and the errors of `parse_json`.
    """
    if media_type(request) != "application/json" or request.headers.get("content-encoding"):
        raise UnsupportedEncoding("this call takes application/json without Content-Encoding")
    if _declared_bytes(request, schema.most_bytes) <= SHORT_JSON_BYTES:
        return parse_json(await _charged_body(request, SHORT_JSON_BYTES), schema, limits_of(request))
    turns: Turns = request.app.state.long_bodies
    # Its turn comes before it is read: a client that sends many at once waits for itself.
    async with turns.of(current_tenant()):
        data = await _charged_body(request, schema.most_bytes)
        return await asyncio.to_thread(parse_json, data, schema, limits_of(request))


def parse_json(data: bytes, schema: type[SchemaT], limits: HttpLimits) -> SchemaT:
    """Strict JSON: UTF-8 without BOM, no NaN, no duplicate keys, bounded structure, no unknown or coerced fields.

    Any body of its schema takes a few milliseconds at most.

    Raises MalformedBody for invalid JSON, BadField for JSON that does not fit the schema.
    """
    try:
        text = data.decode("utf-8", errors="strict")
        _check_structure(text, limits, schema.most_bytes)
        hook = partial(_without_duplicates, most=limits.json_keys)
        read = _finite if _MAYBE_HUGE.search(text) else None
        json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=hook, parse_float=read)
    except (ValueError, RecursionError) as error:
        raise MalformedBody("the body is not strict JSON in UTF-8") from error
    try:
        return schema.model_validate_json(data)
    except ValidationError as error:
        raise bad_field(error.errors(include_url=False, include_context=False, include_input=False)) from error


async def _charged_body(request: Request, most: int) -> bytes:
    admission: Admission = request.app.state.use_cases.admission
    data = await body_bytes(request, most)
    request.app.state.use_cases.access.note_json(len(data))
    admission.charge_call(current_tenant(), int(JSON_POINTS_A_BYTE * len(data)))
    return data


async def cloud_body(request: Request) -> EncodedCloud:
    """A dependency: the body as an encoded cloud, still compressed where it was sent so."""
    content_type = media_type(request)
    if not content_type:
        raise UnsupportedEncoding("a cloud needs a Content-Type")
    return EncodedCloud(await body_bytes(request), content_type, request.headers.get("content-encoding"))


async def body_bytes(request: Request, most: int | None = None) -> bytes:
    """The whole body, within the limit that the middleware enforces, or of at most `most` bytes.

    Raises TooLarge, mostly before anything is read; MalformedBody where the client left.
    """
    most = limits_of(request).body_bytes if most is None else most
    _declared_bytes(request, most)
    data = bytearray()
    try:
        async for chunk in request.stream():
            data += chunk
            if len(data) > most:
                raise TooLarge(f"this body may have at most {most} bytes")
    except ClientDisconnect as error:
        raise MalformedBody("the client went away before the body was complete") from error
    return bytes(data)


def _declared_bytes(request: Request, most: int) -> int:
    """The length that a body declares; where it declares none, `most`. Raises TooLarge beyond that."""
    # The middleware has refused values that are no number.
    declared = int(request.headers.get("content-length", str(most))[:20])
    if declared > most:
        raise TooLarge(f"this body may have at most {most} bytes")
    return declared


def media_type(request: Request) -> str:
    """The Content-Type without its parameters, lower case."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


def limits_of(request: Request) -> HttpLimits:
    """The limits the app was created with."""
    limits: HttpLimits = request.app.state.limits
    return limits


def _check_structure(text: str, limits: HttpLimits, most_bytes: int) -> None:
    """Raises MalformedBody for more arrays and objects, or deeper ones, than a call takes with bodies so long."""
    depth, containers = 0, limits.json_containers * max(1, most_bytes // SHORT_JSON_BYTES)
    for number, bracket in enumerate(_BRACKET.finditer(_STRING.sub("", text))):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > limits.json_depth or number >= 2 * containers:
            raise MalformedBody(f"JSON may nest at most {limits.json_depth} deep, in {containers} arrays and objects")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _finite(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError("number out of range")
    return value


def _without_duplicates(pairs: list[tuple[str, Any]], most: int) -> dict[str, Any]:
    if len(pairs) > most:
        raise ValueError("too many keys")
    keys = {key for key, _ in pairs}
    if len(keys) != len(pairs):
        raise ValueError("duplicate key")
    return dict(pairs)


def parse_numbers(text: str, count: int, field: str, order: str) -> list[float]:
    """`count` finite numbers separated by commas, in the `order` that errors name. Raises BadField naming `field`."""
    parts = text.split(",")
    try:
        numbers = [_finite(part) for part in parts if part.isascii() and "_" not in part]
    except ValueError as error:
        raise BadField(f"{field} must be {count} numbers separated by commas: {order}", field=field) from error
    if len(numbers) != count or len(parts) != count or any(number != number for number in numbers):
        raise BadField(f"{field} must be {count} finite numbers separated by commas: {order}", field=field)
    return numbers
