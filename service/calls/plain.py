"""Calls that are answered by one use case as it is, a row each.

A use case gets, after the tenant, the resource that the request names, the page of a list, and the other fields of the
request in their order. Its result becomes the answer by the type of the response.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, cast

from google.protobuf.descriptor import Descriptor

from revisit.api.calls import NAMED, Call
from revisit.service.calls.anchors import anchor_fields
from revisit.service.calls.catalogue import map_fields, robot_fields, session_fields, submap_fields
from revisit.service.calls.loops import loop_event_fields, loop_fields
from revisit.service.calls.map_parts import file_fields, tile_fields
from revisit.service.calls.mapping import (
    change_fields,
    correction_fields,
    merge_fields,
    submap_pose_fields,
    version_fields,
)
from revisit.service.calls.operations import asked_fields, operation_fields
from revisit.service.calls.plans import plan_fields
from revisit.service.calls.push import delivery_fields, webhook_fields
from revisit.service.domain.identity import TenantId
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields
from revisit.service.wire.rendering import Answer, Listed

USES: Mapping[str, Callable[[UseCases], Callable[..., Awaitable[Any]]]] = {
    "GetMap": lambda cases: cases.maps.get,
    "ListMaps": lambda cases: cases.maps.list,
    "DeleteMap": lambda cases: cases.maps.delete,
    "GetRobot": lambda cases: cases.robots.get,
    "ListRobots": lambda cases: cases.robots.list,
    "GetSession": lambda cases: cases.sessions.get,
    "ListSessions": lambda cases: cases.sessions.list,
    "FinishSession": lambda cases: cases.sessions.finish,
    "DeleteSession": lambda cases: cases.sessions.delete,
    "ListSubmaps": lambda cases: cases.submaps.list,
    "DeleteSubmap": lambda cases: cases.submaps.delete,
    "ListAnchors": lambda cases: cases.anchors.list,
    "DeleteAnchor": lambda cases: cases.anchors.delete,
    "GetLoopClosure": lambda cases: cases.loops.get,
    "AcceptLoopClosure": lambda cases: cases.loop_decisions.accept,
    "RejectLoopClosure": lambda cases: cases.loop_decisions.reject,
    "RevertLoopClosure": lambda cases: cases.loop_decisions.revert,
    "ListLoopClosureEvents": lambda cases: cases.loop_decisions.events,
    "OptimiseMap": lambda cases: cases.map_versions.optimise,
    "ListMapVersions": lambda cases: cases.map_versions.list,
    "GetMapVersion": lambda cases: cases.map_versions.get,
    "ListSubmapPoses": lambda cases: cases.map_versions.poses,
    "RevertMap": lambda cases: cases.map_versions.revert,
    "ListMapMerges": lambda cases: cases.map_merges.list,
    "GetMapMerge": lambda cases: cases.map_merges.get,
    "RevertMapMerge": lambda cases: cases.map_merges.revert,
    "GetCorrection": lambda cases: cases.corrections.get,
    "ListMapTiles": lambda cases: cases.map_tiles.list,
    "ListMapChanges": lambda cases: cases.map_changes.list,
    "PublishMapFile": lambda cases: cases.map_files.publish,
    "GetMapFile": lambda cases: cases.map_files.get,
    "ListMapFiles": lambda cases: cases.map_files.list,
    "EnableMapFile": lambda cases: cases.map_files.enable,
    "DeleteMapFile": lambda cases: cases.map_files.delete,
    "GetPlan": lambda cases: cases.plans.get,
    "ListPlans": lambda cases: cases.plans.list,
    "DeletePlan": lambda cases: cases.plans.delete,
    "GetOperation": lambda cases: cases.operations.get,
    "RetryOperation": lambda cases: cases.dead_letters.retry,
    "CancelOperation": lambda cases: cases.operations.cancel,
    "GetWebhook": lambda cases: cases.webhooks.get,
    "ListWebhooks": lambda cases: cases.webhooks.list,
    "DeleteWebhook": lambda cases: cases.webhooks.delete,
    "ResumeWebhook": lambda cases: cases.webhooks.resume,
    "ListWebhookDeliveries": lambda cases: cases.webhooks.deliveries,
}
"""The use case of a call, by the name of its RPC."""

FIELDS: Mapping[str, Callable[[Any], Fields]] = {
    "Map": map_fields,
    "Robot": robot_fields,
    "Session": session_fields,
    "Submap": submap_fields,
    "Anchor": anchor_fields,
    "LoopClosure": loop_fields,
    "LoopClosureEvent": loop_event_fields,
    "MapVersion": version_fields,
    "SubmapPose": submap_pose_fields,
    "MapMerge": merge_fields,
    "MapChange": change_fields,
    "Correction": correction_fields,
    "MapTile": tile_fields,
    "MapFile": file_fields,
    "Plan": plan_fields,
    "Operation": operation_fields,
    "Webhook": webhook_fields,
    "WebhookDelivery": delivery_fields,
}
"""From a result to the fields of a message, by the message's name."""

_PAGE = {"page_size", "page_token"}


def answers(call: Call, cases: UseCases) -> Callable[[TenantId, Any], Awaitable[Answer]]:
    """Answers one request of a tenant."""
    use, arguments, result = USES[call.name], _arguments(call), _result(call)

    async def answer(tenant: TenantId, request: Any) -> Answer:
        return result(await use(cases)(tenant, *arguments(request)))

    return answer


def _arguments(call: Call) -> Callable[[Any], list[Any]]:
    """From a request to the arguments of its use case behind the tenant."""
    found, fields = NAMED.search(call.row.http), [field.name for field in call.method.input_type.fields]
    named = found["field"] if found else None
    others = [name for name in fields if name != named and name not in _PAGE]

    def arguments(request: Any) -> list[Any]:
        key = names.key_of(getattr(request, found["field"]), found["pattern"], found["field"]) if found else ()
        page = [requests.page(request)] if "page_token" in fields else []
        return [*key, *page, *(getattr(request, name) for name in others)]

    return arguments


def _result(call: Call) -> Callable[[Any], Answer]:
    """From the result of a use case to the answer: nothing, an operation, a page, or one resource."""
    fields = call.method.output_type.fields
    if not fields:
        return lambda _: {}
    if {field.name for field in fields} == {"operation", "replay"}:
        return asked_fields
    resource = fields[0]
    make = FIELDS[cast(Descriptor, resource.message_type).name]
    if resource.is_repeated:
        return lambda page: Listed(resource.name, page, make)
    return lambda view: {resource.name: make(view)}
