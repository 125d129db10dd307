"""Webhooks: the receivers of a tenant's events, the deliveries, and the port that sends them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from revisit.service.domain.identity import TenantId


@dataclass(frozen=True)
class WebhookRecord:
    """Where events are sent. `map_id` and `kinds` keep those of one map and of these kinds; None and () keep all.

    `told` is the number, within its map, of the last delivered event (see `WebhookRepository` for all maps), `failures`
    counts the failed attempts since then, and `due_at_ns` (wall clock) is when the next may be made. `secret` signs the
    requests.
    """

    tenant: TenantId
    webhook_id: str
    content_hash: str
    url: str
    map_id: str | None
    kinds: tuple[str, ...]
    secret: str
    state: str
    told: int
    failures: int
    due_at_ns: int
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class News:
    """What a webhook has not been told of a map: the events behind number `told` up to `last`."""

    told: int
    last: int


@dataclass(frozen=True)
class DeliveryRecord:
    """One attempt to deliver events, the first to the last by their numbers within their maps.

    It has the status of the answer, or why there was none.
    """

    tenant: TenantId
    webhook_id: str
    first_event: int
    last_event: int
    events: int
    attempt: int
    status: int | None
    error: str | None
    took_ms: int
    at_ns: int
    number: int = 0

    @property
    def arrived(self) -> bool:
        """Whether the receiver took it."""
        return self.status is not None and 200 <= self.status < 300


@dataclass(frozen=True)
class Answered:
    """A receiver's answer: an HTTP status, or the reason why there is none."""

    status: int | None = None
    error: str | None = None


class WebhookSender(Protocol):
    """Sends a body to a URL that a client of the service chose: nothing that such a client must not reach."""

    async def send(self, url: str, body: bytes, headers: Mapping[str, str]) -> Answered:
        """POST `body`; never raises for an error of the network or the receiver. No redirect is followed."""
        ...

    async def close(self) -> None:
        """Let go of the connections."""
        ...
