"""Events, and the webhooks that are told of them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence

from pydantic_core import to_json

from revisit.service.calls.anchors import anchor_fields
from revisit.service.calls.loops import loop_fields
from revisit.service.calls.mapping import drive_changes_fields, version_fields
from revisit.service.calls.operations import operation_fields
from revisit.service.calls.retention import report_fields
from revisit.service.domain.identity import TenantId
from revisit.service.domain.webhooks import DeliveryRecord, WebhookRecord
from revisit.service.features.events.calls import EventView
from revisit.service.features.webhooks.calls import CreateWebhook
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of
from revisit.service.wire.json_form import json_form
from revisit.service.wire.rendering import Answer
from revisit.v1 import event_pb2, webhook_pb2


async def watch_events(
    cases: UseCases, tenant: TenantId, request: event_pb2.WatchEventsRequest
) -> AsyncIterator[Fields]:
    """The events of a map, those to come too; an empty answer is a sign of life."""
    map_id, kinds = names.map_id(request.parent, "parent"), frozenset(requests.event_kinds(request.kinds))
    async for view in cases.events.watch(tenant, map_id, requests.optional(request, "after"), kinds):
        yield {"event": None if view is None else event_fields(view)}


async def create_webhook(cases: UseCases, tenant: TenantId, request: webhook_pb2.CreateWebhookRequest) -> Answer:
    """A new webhook with its secret."""
    map_id = names.map_id(request.map, "map") if request.map else None
    kinds = tuple(requests.event_kinds(request.kinds))
    created = await cases.webhooks.create(tenant, CreateWebhook(request.webhook_id, request.url, map_id, kinds))
    return {"webhook": webhook_fields(created.webhook), "secret": created.secret, "replay": created.replay}


def event_fields(view: EventView) -> Fields:
    """The fields of an Event."""
    return fields_of(
        event_pb2.Event,
        view,
        map=f"maps/{view.map_id}" if view.map_id else "",
        loop_closure=None if view.loop is None else loop_fields(view.loop),
        operation=None if view.operation is None else operation_fields(view.operation),
        map_version=None if view.map_version is None else version_fields(view.map_version),
        retention=None if view.retention is None else report_fields(view.retention),
        anchor=None if view.anchor is None else anchor_fields(view.anchor),
        drive_changes=None if view.drive_changes is None else drive_changes_fields(view.drive_changes),
    )


def webhook_fields(record: WebhookRecord) -> Fields:
    """The fields of a Webhook."""
    map_name = f"maps/{record.map_id}" if record.map_id else ""
    return fields_of(webhook_pb2.Webhook, record, name=f"webhooks/{record.webhook_id}", map=map_name)


def delivery_fields(record: DeliveryRecord) -> Fields:
    """The fields of a WebhookDelivery."""
    return fields_of(webhook_pb2.WebhookDelivery, record)


def webhook_body(name: str, events: Sequence[EventView]) -> bytes:
    """The body of a request to a webhook, by its resource name: JSON of a WebhookBody."""
    fields = {"webhook": name, "events": [event_fields(event) for event in events]}
    return to_json(json_form(webhook_pb2.WebhookBody, fields), inf_nan_mode="null")
