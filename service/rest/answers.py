"""Answers: messages of `proto/revisit/v1` as JSON, and their part of OpenAPI."""

from __future__ import annotations

from typing import Any

from fastapi import Response
from google.protobuf.message import Message
from pydantic_core import to_json

from revisit.api.calls import CALLS, Call, Form
from revisit.service.wire import openapi
from revisit.service.wire.fields import Fields, descriptor_of
from revisit.service.wire.json_form import json_form
from revisit.v1 import event_pb2, ingest_pb2

_OF_ROUTES_BY_HAND = (ingest_pb2.AppendScanResponse, event_pb2.Event)


def status_of(call: Call) -> int:
    """The status of an answer: 201 for a creation, 202 for an operation, 204 for an empty answer."""
    if call.row.http.startswith("DELETE"):
        return 204
    if "replay" not in descriptor_of(call.response).fields_by_name:
        return 200
    return 201 if call.name.startswith("Create") else 202


def answers(message: type[Message], status: int = 200) -> dict[str, Any]:
    """The arguments of a route that answers with `message`."""
    content = {"application/json": {"schema": openapi.reference(message)}}
    return {
        "status_code": status,
        "response_class": Response,
        "response_model": None,
        "responses": {status: {"content": content}},
    }


def event_answers() -> dict[str, Any]:
    """The arguments of a route that answers with events as they happen: in OpenAPI, the data of one of them."""
    content = {"text/event-stream": {"schema": {"type": "string", "description": "Server-sent events: see Event."}}}
    return {"response_class": Response, "response_model": None, "responses": {200: {"content": content}}}


def answer(message: type[Message], fields: Fields, status: int = 200, *, replay: bool = False) -> Response:
    """The JSON of a message; an identical create answers as the first did, with `Idempotent-Replay: true`."""
    headers = {"idempotent-replay": "true"} if replay else None
    return Response(to_json(json_form(message, fields), inf_nan_mode="null"), status, headers, "application/json")


def describe_answers(document: dict[str, Any]) -> None:
    """Add the schemas of all answers to the OpenAPI document."""
    over_http = (
        call for call in CALLS.values() if call.row.http and call.row.form in (Form.MESSAGE, Form.CLOUD, Form.IMAGE)
    )
    served = (call.body for call in over_http if status_of(call) != 204)
    schemas = openapi.schemas([*served, *_OF_ROUTES_BY_HAND])
    document.setdefault("components", {}).setdefault("schemas", {}).update(schemas)
