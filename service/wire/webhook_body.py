"""The body of the requests that webhooks get: JSON of a WebhookBody."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic_core import to_json

from revisit.service.application.push.events import EventView
from revisit.service.wire.answers import of_event
from revisit.service.wire.json_form import json_form
from revisit.v1 import webhook_pb2


def webhook_body(name: str, events: Sequence[EventView]) -> bytes:
    """What a webhook, by its resource name, is sent of events."""
    fields = {"webhook": name, "events": [of_event(event) for event in events]}
    return to_json(json_form(webhook_pb2.WebhookBody, fields), inf_nan_mode="null")
