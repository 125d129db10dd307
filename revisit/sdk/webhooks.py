"""Receiving webhooks, signed as Standard Webhooks says: the events of a request from the service, sent just now."""

from __future__ import annotations

import base64
import hmac
import time
from collections.abc import Mapping

from google.protobuf.json_format import Parse, ParseError

from revisit.sdk.errors import ErrorDetails, InvalidArgument, Unauthenticated
from revisit.sdk.resources import Event
from revisit.v1 import webhook_pb2

TOLERANCE_S = 300.0
"""How far the clocks of service and receiver may be apart, with the time of the way."""


def verified(body: bytes, headers: Mapping[str, str], secret: str, *, now_s: float | None = None) -> list[Event]:
    """The events of a request to a webhook; names of headers may have any case.

    One that failed before comes again: leave out those whose `map` and `number` you have had. Raises Unauthenticated
    where the signature is not that of `secret`, or older than `TOLERANCE_S`; InvalidArgument for a malformed body.
    """
    shown = {name.lower(): value for name, value in headers.items()}
    timestamp, signatures = shown.get("webhook-timestamp", ""), shown.get("webhook-signature", "")
    signed = f"{shown.get('webhook-id', '')}.{timestamp}.".encode() + body
    expected = b"v1," + base64.b64encode(hmac.digest(_key(secret), signed, "sha256"))
    if not any(hmac.compare_digest(one.encode(), expected) for one in signatures.split()):
        raise _refused("the signature is not the service's")
    if abs((time.time() if now_s is None else now_s) - int(timestamp)) > TOLERANCE_S:
        raise _refused("the request is too old")
    try:
        message = Parse(body, webhook_pb2.WebhookBody(), ignore_unknown_fields=True)
    except ParseError as error:
        raise InvalidArgument(ErrorDetails("INVALID_ARGUMENT", "MALFORMED_BODY", "no body of a webhook")) from error
    return [Event.of(event) for event in message.events]


def _key(secret: str) -> bytes:
    try:
        return base64.b64decode(secret.removeprefix("whsec_") + "==")
    except ValueError as error:
        raise _refused("the secret is none of a webhook") from error


def _refused(why: str) -> Unauthenticated:
    return Unauthenticated(ErrorDetails("UNAUTHENTICATED", "UNAUTHENTICATED", why))
