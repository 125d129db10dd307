"""Delivering events to webhooks: from the log, in order, until they have arrived.

The log of events is the outbox: a webhook keeps, for each map, the number of the last event that was dealt with, and
its next request holds those behind it. A request that failed is made again after a pause that grows; so events arrive
at least once, and the receiver tells those that it has had by their maps and numbers.
"""

from __future__ import annotations

import asyncio
import base64
import hmac
import random
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import structlog

from revisit.service.domain.identity import TenantId, content_hash
from revisit.service.domain.states import EventKind, WebhookState
from revisit.service.domain.webhooks import Answered, DeliveryRecord, WebhookRecord, WebhookSender
from revisit.service.features.events.calls import EventView, events_of
from revisit.service.features.webhooks.calls import key_of
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

BATCH = 50
"""Events of one request at most."""

BODY_BYTES = 512 * 1024
"""Of a request with several events at most: half of what common receivers take."""

AT_ONCE, OF_TENANT = 64, 4
"""Requests under way: in all, and of one tenant, so that receivers of one that hang hold up nobody else."""

KEPT_FREE = 32
"""Places among them for tenants that have no request under way, so that slow receivers of some do not delay others."""

PAUSE_S = (5.0, 3600.0)
"""After the first failure, doubled with each further one, up to the second."""

MOST_FAILURES = 30
"""In a row, about a day: then the webhook is suspended."""

GONE = 410
"""A receiver that answers so wants nothing more."""

KEPT = 100
"""Attempts of each webhook that are kept for the search for faults."""

log = structlog.get_logger(__name__)

Render = Callable[[str, Sequence[EventView]], bytes]
"""The body that tells a webhook, by its name, of events."""


@dataclass(frozen=True)
class Batch:
    """The next events of a webhook, those of a map together, and its positions behind them."""

    events: list[EventView]
    told: dict[str, int]

    @property
    def last(self) -> int:
        """Its position behind the last of them, in its map."""
        return self.told[self.events[-1].map_id]


@dataclass(frozen=True)
class Deliveries:
    """Sends due events, each webhook one request after another."""

    storage: Storage
    sender: WebhookSender
    clock: Clock
    render: Render
    under_way: dict[tuple[str, str], asyncio.Task[None]] = field(default_factory=dict)

    async def deliver_due(self) -> None:
        """Begin a request for each webhook that is due and has news, where there is a place; does not wait for them."""
        now_ns = self.clock.wall_ns()
        due = await self.storage.read(lambda uow: uow.webhooks.due(now_ns))
        of_tenant = Counter(tenant for tenant, _ in self.under_way)
        for webhook in due:
            key = (webhook.tenant, webhook.webhook_id)
            if key in self.under_way or not _has_slot(of_tenant[webhook.tenant], len(self.under_way)):
                continue
            of_tenant[webhook.tenant] += 1
            task = asyncio.create_task(self._deliver(webhook), name=f"webhook {webhook.webhook_id}")
            self.under_way[key] = task
            task.add_done_callback(partial(self._ended, key))

    def _ended(self, key: tuple[str, str], task: asyncio.Task[None]) -> None:
        self.under_way.pop(key, None)
        if not task.cancelled() and task.exception() is not None:
            log.error("webhook_crashed", webhook=key[1], tenant=key[0], exc_info=task.exception())

    async def settle(self) -> None:
        """Wait for the requests under way."""
        await asyncio.gather(*self.under_way.values(), return_exceptions=True)

    async def close(self) -> None:
        """Give up the requests under way: they are made again after the next start."""
        for task in list(self.under_way.values()):
            task.cancel()
        await self.settle()
        await self.sender.close()

    async def _deliver(self, webhook: WebhookRecord) -> None:
        batch, body = await self._next(webhook)
        if not batch.events:
            await self.storage.write(partial(_go_on, webhook=webhook, told=batch.told))
            return
        began_s, at_ns = time.monotonic(), self.clock.wall_ns()
        answered = await self.sender.send(webhook.url, body, headers_of(webhook, batch, body, at_ns))
        attempt = _attempt(webhook, batch, answered, at_ns, int(1000 * (time.monotonic() - began_s)))
        after = _after(webhook, attempt, self.clock.wall_ns())
        await self.storage.write(partial(_note, before=webhook, after=after, attempt=attempt, told=batch.told))
        if not attempt.arrived:
            fields = {"webhook": webhook.webhook_id, "tenant": webhook.tenant, "failures": after.failures}
            log.warning("webhook_failed", **fields, status=answered.status, reason=answered.error, state=after.state)

    async def _next(self, webhook: WebhookRecord) -> tuple[Batch, bytes]:
        """The next events and the body that tells of them: as many as fit, at least one."""
        most = BATCH
        while True:
            batch = await self.storage.read(partial(_batch, webhook=webhook, most=most))
            body = self.render(f"webhooks/{webhook.webhook_id}", batch.events)
            if len(body) <= BODY_BYTES or len(batch.events) <= 1:
                return batch, body
            most = max(1, len(batch.events) * BODY_BYTES // (2 * len(body)))


def _has_slot(of_tenant: int, in_all: int) -> bool:
    """Whether a tenant with so many requests under way, of so many in all, may begin another."""
    return in_all < (AT_ONCE - KEPT_FREE if of_tenant else AT_ONCE) and of_tenant < OF_TENANT


def signature_of(secret: str, request_id: str, timestamp: str, body: bytes) -> str:
    """The signature of Standard Webhooks: HMAC-SHA256 over id, time and body, so that none of them can be changed.

    Source: github.com/standard-webhooks/standard-webhooks, spec/standard-webhooks.md.
    """
    signed = f"{request_id}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.digest(key_of(secret), signed, "sha256")).decode()


def headers_of(webhook: WebhookRecord, batch: Batch, body: bytes, at_ns: int) -> dict[str, str]:
    """The headers of a request: its id, the time in seconds since 1970, and the signature."""
    request_id = f"{webhook.webhook_id}-{_span(webhook, batch)}"
    timestamp = str(at_ns // 1_000_000_000)
    return {
        "content-type": "application/json",
        "webhook-id": request_id,
        "webhook-timestamp": timestamp,
        "webhook-signature": signature_of(webhook.secret, request_id, timestamp, body),
    }


def _span(webhook: WebhookRecord, batch: Batch) -> str:
    """The events of a batch in short: first and last number, of several maps a hash of these."""
    if webhook.map_id is not None:
        return f"{batch.events[0].number}-{batch.events[-1].number}"
    return content_hash([f"{event.map_id}/{event.number}" for event in batch.events])[:32]


def pause_s(failures: int) -> float:
    """How long to wait after so many failures in a row, seconds: a random half to whole of a time that doubles."""
    whole_s = min(PAUSE_S[1], PAUSE_S[0] * 2.0 ** min(failures - 1, 30))
    return random.uniform(0.5, 1.0) * whole_s


def _batch(uow: UnitOfWork, webhook: WebhookRecord, most: int) -> Batch:
    """At most so many events, as many of each map as of the others, so that none waits for another; of too many maps
    some, drawn at random.
    """
    news = uow.webhooks.news(webhook)
    maps = random.sample(sorted(news), min(len(news), most))
    wanted = {*webhook.kinds, EventKind.FORGOTTEN.value}
    events, told = list[EventView](), dict[str, int]()
    for map_id in sorted(maps):
        share, its = most // len(maps), news[map_id]
        rows = uow.events.following(webhook.tenant, map_id, its.told, share)
        events += events_of(uow, [row for row in rows if not webhook.kinds or row.kind in wanted])
        told[map_id] = rows[-1].number if len(rows) == share else its.last
    return Batch(events, told)


def _attempt(webhook: WebhookRecord, batch: Batch, answered: Answered, at_ns: int, took_ms: int) -> DeliveryRecord:
    return DeliveryRecord(
        tenant=webhook.tenant,
        webhook_id=webhook.webhook_id,
        first_event=batch.events[0].number,
        # Rows behind the last event of the batch told of nothing new: they count as told with it.
        last_event=batch.last,
        events=len(batch.events),
        attempt=webhook.failures + 1,
        status=answered.status,
        error=None if answered.error is None else answered.error[:300],
        took_ms=took_ms,
        at_ns=at_ns,
    )


def _after(webhook: WebhookRecord, attempt: DeliveryRecord, now_ns: int) -> WebhookRecord:
    """The webhook after an attempt."""
    if attempt.arrived:
        return replace(webhook, told=attempt.last_event, failures=0, due_at_ns=0)
    failures = webhook.failures + 1
    given_up = failures >= MOST_FAILURES or attempt.status == GONE
    state = WebhookState.SUSPENDED if given_up else WebhookState.ENABLED
    return replace(webhook, failures=failures, state=state.value, due_at_ns=now_ns + int(1e9 * pause_s(failures)))


def _note(
    uow: UnitOfWork, before: WebhookRecord, after: WebhookRecord, attempt: DeliveryRecord, told: Mapping[str, int]
) -> None:
    """Keep the result of an attempt, unless the webhook was deleted or resumed meanwhile."""
    known = uow.webhooks.get(before.tenant, before.webhook_id, hold=True)
    if known is None or known.number != before.number:
        return
    if known == before or attempt.arrived:
        uow.webhooks.replace(after)
    if attempt.arrived:
        uow.webhooks.tell(known, told)
    uow.webhook_deliveries.add(attempt)
    _trim(uow, before.tenant, before.webhook_id)


def _trim(uow: UnitOfWork, tenant: TenantId, webhook_id: str) -> None:
    if uow.webhook_deliveries.count(tenant, webhook_id=webhook_id) > KEPT:
        (oldest,) = uow.webhook_deliveries.find(tenant, limit=1, webhook_id=webhook_id)
        uow.webhook_deliveries.delete(tenant, number=oldest.number)


def _go_on(uow: UnitOfWork, webhook: WebhookRecord, told: Mapping[str, int]) -> None:
    if uow.webhooks.get(webhook.tenant, webhook.webhook_id, hold=True) == webhook:
        uow.webhooks.tell(webhook, told)
