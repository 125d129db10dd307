"""Every call of the service, one row each: its RPC, HTTP rule, scopes and cost.

The messages come from the descriptor of the RPC (`proto/revisit/v1`), the use case is the function of the same name in
snake case (`Call.use`). The gRPC server registers from these rows, HTTP routes and OpenAPI are made from them, and the
SDK calls by them. Scopes stand nowhere else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, cast

from google.protobuf.descriptor import Descriptor, MethodDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

from revisit.api.scopes import ADMIN, INGEST, QUERY, READ, Scope
from revisit.v1 import (
    anchor_pb2,
    event_pb2,
    ingest_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    plan_pb2,
    radio_pb2,
    retention_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
    webhook_pb2,
)

NAMED = re.compile(r"{(?P<field>name|parent)=(?P<pattern>[^}]+)}")
"""The resource that a path is about, in the field of the request that holds its name."""


class Cost(Enum):
    """Resources of a call while it is served."""

    SMALL = "a message of at most 64 KiB, for a moment"
    CLOUD = "a message as large as a cloud"
    WATCH = "answers until the caller stops"
    SCANS = "a stream in both directions"


class Form(Enum):
    """How a call is served over HTTP. All but MESSAGE have a route written by hand."""

    MESSAGE = "path, query and JSON body make the request; the answer is JSON"
    CLOUD = "the body is a cloud"
    IMAGE = "the body is a picture"
    FILE = "the answer is a file"
    EVENTS = "the answer is a stream of server-sent events"


@dataclass(frozen=True)
class Row:
    """A row of the table: the scopes of a call (a caller needs one), and its HTTP rule, if any.

    `http` is a method and a path as `google.api.http` writes them, `POST /v1/{name=maps/*/sessions/*}:finish`; `answer`
    is the field of the response that is the answer's body, "" for the whole response.
    """

    name: str
    scopes: frozenset[Scope]
    http: str = ""
    answer: str = ""
    form: Form = Form.MESSAGE
    cost: Cost = Cost.SMALL
    json_bytes: int = 0
    """The most that a JSON body may have; 0 for the common bound."""
    tag: str = ""
    """Groups calls in the description of the interface; "" for that of the service's other calls."""


@dataclass(frozen=True)
class Call:
    """A row with the RPC that it is about."""

    row: Row
    method: MethodDescriptor
    tag: str

    @cached_property
    def name(self) -> str:
        """The name of the RPC, which no other service has: `FinishSession`."""
        return self.row.name

    @cached_property
    def path(self) -> str:
        """`/revisit.v1.SessionService/FinishSession`."""
        return f"/{self.method.containing_service.full_name}/{self.name}"

    @cached_property
    def use(self) -> str:
        """The name of the function that answers: `finish_session`."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", self.name).lower()

    @cached_property
    def request(self) -> type[Message]:
        """The request message."""
        return GetMessageClass(self.method.input_type)

    @cached_property
    def response(self) -> type[Message]:
        """The response message, one of many where the answers are a stream."""
        return GetMessageClass(self.method.output_type)

    @cached_property
    def body(self) -> type[Message]:
        """The message that is the body of the answer over HTTP."""
        if not self.row.answer:
            return self.response
        field = self.method.output_type.fields_by_name[self.row.answer]
        return GetMessageClass(cast(Descriptor, field.message_type))

    def body_in(self, response: Message) -> Any:
        """The part of a response that is the body of the answer over HTTP."""
        return getattr(response, self.row.answer) if self.row.answer else response


def _calls(module: Any, tag: str, *rows: Row) -> tuple[Call, ...]:
    """The calls of a proto file's only service."""
    (service,) = module.DESCRIPTOR.services_by_name.values()
    return tuple(Call(row, service.methods_by_name[row.name], row.tag or tag) for row in rows)


_TABLE = (
    *_calls(
        map_pb2,
        "maps",
        Row("CreateMap", INGEST, "POST /v1/maps", "map"),
        Row("GetMap", READ, "GET /v1/{name=maps/*}", "map"),
        Row("ListMaps", READ, "GET /v1/maps"),
        Row("DeleteMap", ADMIN, "DELETE /v1/{name=maps/*}"),
    ),
    *_calls(
        robot_pb2,
        "robots",
        Row("CreateRobot", INGEST, "POST /v1/robots", "robot"),
        Row("GetRobot", READ, "GET /v1/{name=robots/*}", "robot"),
        Row("ListRobots", READ, "GET /v1/robots"),
    ),
    *_calls(
        session_pb2,
        "sessions",
        Row("CreateSession", INGEST, "POST /v1/{parent=maps/*}/sessions", "session"),
        Row("GetSession", READ, "GET /v1/{name=maps/*/sessions/*}", "session"),
        Row("ListSessions", READ, "GET /v1/{parent=maps/*}/sessions"),
        Row("FinishSession", INGEST, "POST /v1/{name=maps/*/sessions/*}:finish", "session"),
        Row("DeleteSession", ADMIN, "DELETE /v1/{name=maps/*/sessions/*}"),
    ),
    *_calls(
        submap_pb2,
        "submaps",
        Row(
            "PostSubmap",
            INGEST,
            "POST /v1/{parent=maps/*/sessions/*}/submaps",
            form=Form.CLOUD,
            cost=Cost.CLOUD,
        ),
        Row("GetSubmap", READ, "GET /v1/{name=maps/*/sessions/*/submaps/*}", "submap"),
        Row("ListSubmaps", READ, "GET /v1/{parent=maps/*/sessions/*}/submaps"),
        Row("DownloadSubmap", QUERY, "GET /v1/{name=maps/*/sessions/*/submaps/*}:download", form=Form.FILE),
        Row("DeleteSubmap", ADMIN, "DELETE /v1/{name=maps/*/sessions/*/submaps/*}"),
    ),
    *_calls(
        anchor_pb2,
        "anchors",
        # Two hundred, written with all digits.
        Row("PostAnchors", INGEST, "POST /v1/{parent=maps/*/sessions/*}/anchors", json_bytes=256 * 2**10),
        Row("PreviewAnchors", INGEST, "POST /v1/{parent=maps/*/sessions/*}/anchors:preview", json_bytes=256 * 2**10),
        Row("ListAnchors", READ, "GET /v1/{parent=maps/*/sessions/*}/anchors"),
        Row("DeleteAnchor", ADMIN, "DELETE /v1/{name=maps/*/sessions/*/anchors/*}"),
    ),
    *_calls(
        radio_pb2,
        "radio",
        Row("PostRadio", INGEST, "POST /v1/{parent=maps/*/sessions/*}/radio", json_bytes=256 * 2**10),
    ),
    *_calls(ingest_pb2, "scans", Row("StreamScans", INGEST, cost=Cost.SCANS)),
    *_calls(
        loop_closure_pb2,
        "loop closures",
        Row(
            "SearchSubmaps",
            QUERY,
            "POST /v1/{parent=maps/*}/submaps:search",
            form=Form.CLOUD,
            cost=Cost.CLOUD,
            tag="searches",
        ),
        Row(
            "Localize",
            QUERY,
            "POST /v1/{parent=maps/*}:localize",
            form=Form.CLOUD,
            cost=Cost.CLOUD,
            tag="searches",
        ),
        Row("Relocalise", QUERY, cost=Cost.SCANS, tag="searches"),
        Row("GetLoopClosure", QUERY, "GET /v1/{name=maps/*/loopClosures/*}", "loop_closure"),
        Row("ListLoopClosures", QUERY, "GET /v1/{parent=maps/*}/loopClosures"),
        Row("WatchLoopClosures", QUERY, cost=Cost.WATCH),
        Row("CreateLoopClosure", ADMIN, "POST /v1/{parent=maps/*}/loopClosures"),
        Row("AcceptLoopClosure", ADMIN, "POST /v1/{name=maps/*/loopClosures/*}:accept", "loop_closure"),
        Row("RejectLoopClosure", ADMIN, "POST /v1/{name=maps/*/loopClosures/*}:reject", "loop_closure"),
        Row("RevertLoopClosure", ADMIN, "POST /v1/{name=maps/*/loopClosures/*}:revert", "loop_closure"),
        Row("ListLoopClosureEvents", QUERY, "GET /v1/{parent=maps/*/loopClosures/*}/events"),
        Row("GetLoopClosureKeypoints", QUERY, "GET /v1/{name=maps/*/loopClosures/*}/keypoints"),
    ),
    *_calls(
        webhook_pb2,
        "webhooks",
        Row("CreateWebhook", ADMIN, "POST /v1/webhooks"),
        Row("GetWebhook", ADMIN, "GET /v1/{name=webhooks/*}", "webhook"),
        Row("ListWebhooks", ADMIN, "GET /v1/webhooks"),
        Row("DeleteWebhook", ADMIN, "DELETE /v1/{name=webhooks/*}"),
        Row("ResumeWebhook", ADMIN, "POST /v1/{name=webhooks/*}:resume", "webhook"),
        Row("ListWebhookDeliveries", ADMIN, "GET /v1/{parent=webhooks/*}/deliveries"),
    ),
    *_calls(
        event_pb2,
        "events",
        Row("WatchEvents", QUERY, "GET /v1/{parent=maps/*}/events", form=Form.EVENTS, cost=Cost.WATCH),
    ),
    *_calls(
        mapping_pb2,
        "mapping",
        Row("OptimiseMap", INGEST | ADMIN, "POST /v1/{name=maps/*}:optimise", "operation"),
        Row("ListMapVersions", READ, "GET /v1/{parent=maps/*}/versions"),
        Row("GetMapVersion", READ, "GET /v1/{name=maps/*/versions/*}", "map_version"),
        Row("ListSubmapPoses", READ, "GET /v1/{parent=maps/*/versions/*}/poses"),
        Row("RevertMap", ADMIN, "POST /v1/{name=maps/*}:revert", "map_version"),
        Row("MergeMap", ADMIN, "POST /v1/{name=maps/*}:merge", "operation"),
        Row("ListMapMerges", READ, "GET /v1/{parent=maps/*}/merges"),
        Row("GetMapMerge", READ, "GET /v1/{name=maps/*/merges/*}", "map_merge"),
        Row("ListMapChanges", QUERY, "GET /v1/{parent=maps/*/versions/*}/changes"),
        Row("RevertMapMerge", ADMIN, "POST /v1/{name=maps/*/merges/*}:revert", "map_merge"),
        Row("GetCorrection", READ, "GET /v1/{name=maps/*/sessions/*}:correction", "correction"),
        Row("WatchCorrections", READ, cost=Cost.WATCH),
    ),
    *_calls(
        map_tile_pb2,
        "tiles",
        Row("ListMapTiles", READ, "GET /v1/{parent=maps/*/versions/*}/tiles"),
        Row("DownloadMapTile", QUERY, "GET /v1/{name=maps/*/versions/*/tiles/*}:download", form=Form.FILE),
        # A thousand points, written with all digits.
        Row("MeasureMapDistances", QUERY, "POST /v1/{parent=maps/*/versions/*}:distances", json_bytes=128 * 2**10),
        Row("FindMapPoints", QUERY, "GET /v1/{parent=maps/*/versions/*}/points"),
    ),
    *_calls(
        map_file_pb2,
        "map files",
        Row("PublishMapFile", ADMIN, "POST /v1/{parent=maps/*/versions/*}:publish", "operation"),
        Row("GetMapFile", READ, "GET /v1/{name=maps/*/files/*}", "map_file"),
        Row("ListMapFiles", READ, "GET /v1/{parent=maps/*}/files"),
        Row("EnableMapFile", ADMIN, "POST /v1/{name=maps/*/files/*}:enable", "map_file"),
        Row("DeleteMapFile", ADMIN, "DELETE /v1/{name=maps/*/files/*}"),
        Row("DownloadMapFile", READ, "GET /v1/{name=maps/*/files/*}:download", form=Form.FILE),
    ),
    *_calls(
        plan_pb2,
        "plans",
        Row("CreatePlan", ADMIN, "POST /v1/{parent=maps/*}/plans", "plan", form=Form.IMAGE, cost=Cost.CLOUD),
        Row("GetPlan", READ, "GET /v1/{name=maps/*/plans/*}", "plan"),
        Row("ListPlans", READ, "GET /v1/{parent=maps/*}/plans"),
        Row("PinPlan", ADMIN, "POST /v1/{name=maps/*/plans/*}:pin", "plan"),
        Row("DeletePlan", ADMIN, "DELETE /v1/{name=maps/*/plans/*}"),
        Row("DownloadPlan", READ, "GET /v1/{name=maps/*/plans/*}:download", form=Form.FILE),
    ),
    *_calls(
        retention_pb2,
        "retention",
        Row("GetRetention", READ, "GET /v1/{name=maps/*}:retention", "retention"),
        Row("SetRetention", ADMIN, "POST /v1/{name=maps/*}:setRetention", "retention"),
        Row("PreviewRetention", ADMIN, "POST /v1/{name=maps/*}:previewRetention", "report"),
    ),
    *_calls(
        operation_pb2,
        "operations",
        Row("GetOperation", READ, "GET /v1/{name=operations/*}", "operation"),
        Row("ListOperations", READ, "GET /v1/operations"),
        Row("WaitOperation", READ, "GET /v1/{name=operations/*}:wait", "operation"),
        Row("RetryOperation", ADMIN, "POST /v1/{name=operations/*}:retry", "operation"),
        Row("CancelOperation", INGEST | ADMIN, "POST /v1/{name=operations/*}:cancel", "operation"),
    ),
    *_calls(system_pb2, "system", Row("GetStatus", READ, "GET /v1/status")),
)

CALLS = {call.name: call for call in _TABLE}
"""By the name of the RPC."""
