"""Request bodies: JSON read strictly, clouds with their transport compression removed within bounds."""

from __future__ import annotations

import json
import re
from typing import Any, TypeVar

from fastapi import Depends
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect, Request

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.formats import MEDIA_TYPES
from revisit.service.application.ingest.clouds import EncodedCloud
from revisit.service.rest.errors import bad_field
from revisit.service.rest.limits import HttpLimits

SchemaT = TypeVar("SchemaT", bound=BaseModel)

# Ends with the text where a string does not, and gives nothing back: else one without an end is tried at each quote.
_STRING = re.compile(r'"(?:[^"\\]++|\\.)*+"?', re.DOTALL)
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
        return parse_json(await json_bytes(request), schema, limits_of(request))

    return Depends(read)


def describe_json(schema: type[BaseModel]) -> dict[str, Any]:
    """The OpenAPI part for a body read by `json_body`."""
    content = {"application/json": {"schema": schema.model_json_schema()}}
    return {"requestBody": {"required": True, "content": content}}


async def json_bytes(request: Request) -> bytes:
    """The body of an `application/json` request. Raises UnsupportedEncoding, TooLarge."""
    if media_type(request) != "application/json" or request.headers.get("content-encoding"):
        raise UnsupportedEncoding("this call takes application/json without Content-Encoding")
    limit = limits_of(request).json_bytes
    data = await body_bytes(request)
    if len(data) > limit:
        raise TooLarge(f"a JSON body may have at most {limit} bytes")
    return data


def parse_json(data: bytes, schema: type[SchemaT], limits: HttpLimits) -> SchemaT:
    """Strict JSON: UTF-8 without BOM, no NaN, no duplicate keys, bounded depth, no unknown or coerced fields.

    Raises MalformedBody for what is not such JSON, BadField for what does not fit the schema.
    """
    try:
        text = data.decode("utf-8", errors="strict")
        _check_depth(text, limits.json_depth)
        json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_without_duplicates, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise MalformedBody("the body is not strict JSON in UTF-8") from error
    try:
        return schema.model_validate_json(data)
    except ValidationError as error:
        raise bad_field(error.errors(include_url=False, include_context=False, include_input=False)) from error


async def cloud_body(request: Request) -> EncodedCloud:
    """A dependency: the body as an encoded cloud, still compressed where it was sent so."""
    content_type = media_type(request)
    if not content_type:
        raise UnsupportedEncoding("a cloud needs a Content-Type")
    return EncodedCloud(await body_bytes(request), content_type, request.headers.get("content-encoding"))


async def body_bytes(request: Request) -> bytes:
    """The whole body, within the limit that the middleware enforces. Raises MalformedBody where the client left."""
    data = bytearray()
    try:
        async for chunk in request.stream():
            data += chunk
    except ClientDisconnect as error:
        raise MalformedBody("the client went away before the body was complete") from error
    return bytes(data)


def media_type(request: Request) -> str:
    """The Content-Type without its parameters, lower case."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


def limits_of(request: Request) -> HttpLimits:
    """The limits the app was created with."""
    limits: HttpLimits = request.app.state.limits
    return limits


def _check_depth(text: str, limit: int) -> None:
    depth = 0
    for bracket in _BRACKET.finditer(_STRING.sub("", text)):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > limit:
            raise MalformedBody(f"JSON may nest at most {limit} deep")


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _finite(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError("number out of range")
    return value


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
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
