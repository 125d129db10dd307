"""Answers: messages of `proto/revisit/v1` as JSON, and what OpenAPI says about them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from fastapi import Response
from google.protobuf.message import Message
from pydantic_core import to_json

from revisit.service.application.catalogue.paging import Page
from revisit.service.wire import openapi
from revisit.service.wire.answers import Fields, of_page
from revisit.service.wire.json_form import json_form
from revisit.service.wire.rendering import rendered
from revisit.v1 import (
    event_pb2,
    ingest_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
    webhook_pb2,
)

CreatedWebhook = webhook_pb2.CreateWebhookResponse
Webhook = webhook_pb2.Webhook
WebhookPage = webhook_pb2.ListWebhooksResponse
DeliveryPage = webhook_pb2.ListWebhookDeliveriesResponse
Event = event_pb2.Event
Correction = mapping_pb2.Correction
MapMerge = mapping_pb2.MapMerge
MapFile = map_file_pb2.MapFile
MapFilePage = map_file_pb2.ListMapFilesResponse
MapTilePage = map_tile_pb2.ListMapTilesResponse
MapDistances = map_tile_pb2.MeasureMapDistancesResponse
MapPoints = map_tile_pb2.FindMapPointsResponse
MapMergePage = mapping_pb2.ListMapMergesResponse
MapVersion = mapping_pb2.MapVersion
MapVersionPage = mapping_pb2.ListMapVersionsResponse
SubmapPosePage = mapping_pb2.ListSubmapPosesResponse
Ack = ingest_pb2.AppendScanResponse
LocalizeAnswer = loop_closure_pb2.LocalizeResponse
LoopClosure = loop_closure_pb2.LoopClosure
LoopClosurePage = loop_closure_pb2.ListLoopClosuresResponse
LoopKeypoints = loop_closure_pb2.GetLoopClosureKeypointsResponse
LoopClosureEventPage = loop_closure_pb2.ListLoopClosureEventsResponse
ProposedLoop = loop_closure_pb2.CreateLoopClosureResponse
Map = map_pb2.Map
MapPage = map_pb2.ListMapsResponse
Operation = operation_pb2.Operation
OperationPage = operation_pb2.ListOperationsResponse
Posted = submap_pb2.PostSubmapResponse
Robot = robot_pb2.Robot
RobotPage = robot_pb2.ListRobotsResponse
SearchAnswer = loop_closure_pb2.SearchSubmapsResponse
Session = session_pb2.Session
SessionPage = session_pb2.ListSessionsResponse
Status = system_pb2.GetStatusResponse
Submap = submap_pb2.Submap
SubmapPage = submap_pb2.ListSubmapsResponse

T = TypeVar("T")

_DESCRIBED = (
    Ack, Event, LocalizeAnswer, LoopClosurePage, MapPage, OperationPage, Posted, RobotPage, SearchAnswer, SessionPage,
    Status, SubmapPage, Correction, MapVersionPage, SubmapPosePage, MapMergePage, MapTilePage, MapDistances,
    MapPoints, MapFilePage,
    LoopClosureEventPage, LoopKeypoints, ProposedLoop, CreatedWebhook, WebhookPage, DeliveryPage,
)  # fmt: skip


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


async def page_answer(message: type[Message], collection: str, page: Page[T], of: Callable[[T], Fields]) -> Response:
    """As `answer`, of a List...Response that holds `collection`; made beside the event loop where it is long."""
    return await rendered(page, lambda: answer(message, of_page(collection, page, of)))


def describe_answers(document: dict[str, Any]) -> None:
    """Add the schemas of all answers to the OpenAPI document."""
    schemas = openapi.schemas(_DESCRIBED)
    document.setdefault("components", {}).setdefault("schemas", {}).update(schemas)
