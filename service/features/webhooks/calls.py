"""Webhooks: create, get, list, delete and resume them; list the last deliveries."""

from __future__ import annotations

import base64
import secrets
from dataclasses import dataclass, replace
from functools import partial

from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound, QuotaReached
from revisit.service.domain.identity import TenantId, content_hash, validated_id
from revisit.service.domain.states import EventKind, WebhookState
from revisit.service.domain.webhooks import DeliveryRecord, WebhookRecord
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.webhooks.rules import validated_url
from revisit.service.ports.storage import require_map, require_same_content
from revisit.service.ports.transactions import UnitOfWork

SECRET_PREFIX = "whsec_"
"""The beginning of a secret by Standard Webhooks, which scanners of repositories know."""

TOLD_OF = (
    EventKind.LOOP_CLOSURE, EventKind.OPERATION, EventKind.MAP_VERSION, EventKind.RETENTION, EventKind.ANCHOR,
    EventKind.MAP_CHANGED,
)  # fmt: skip
"""The kinds that a webhook may be kept to; FORGOTTEN comes in any case."""


def new_secret() -> str:
    """A key of 256 random bits in base64, behind its prefix."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def key_of(secret: str) -> bytes:
    """The key of a secret."""
    return base64.b64decode(secret.removeprefix(SECRET_PREFIX) + "==")


@dataclass(frozen=True)
class CreateWebhook:
    """A new webhook; `map_id` keeps the events of one map, `kinds` those of these kinds, where given."""

    webhook_id: str
    url: str
    map_id: str | None = None
    kinds: tuple[EventKind, ...] = ()


@dataclass(frozen=True)
class CreatedWebhook:
    """The webhook; its `secret`, which is told this once, "" on a replay."""

    webhook: WebhookRecord
    secret: str
    replay: bool


class Webhooks:
    """The webhooks of a tenant."""

    def __init__(self, context: CallContext) -> None:
        """With private networks in the policy, webhooks may lead anywhere, and over plain HTTP."""
        self._context = context
        self._private = context.policy.webhook_private_networks

    async def create(self, tenant: TenantId, command: CreateWebhook) -> CreatedWebhook:
        """Send the events from now on to a URL.

        Raises BadField; NotFound for the map; AlreadyExists where the id is taken by other content; QuotaReached;
        RateLimited, Draining.
        """
        self._context.admission.charge_creation(tenant)
        if not set(command.kinds) <= set(TOLD_OF):
            raise BadField(f"kinds may be {', '.join(kind.value for kind in TOLD_OF)}", field="kinds")
        kinds = tuple(sorted({kind.value for kind in command.kinds}))
        url = validated_url(command.url, private=self._private)
        record = WebhookRecord(
            tenant=tenant,
            webhook_id=validated_id(command.webhook_id, "webhook_id"),
            content_hash=content_hash([url, command.map_id, *kinds]),
            url=url,
            map_id=command.map_id,
            kinds=kinds,
            secret=new_secret(),
            state=WebhookState.ENABLED.value,
            told=0,
            failures=0,
            due_at_ns=0,
            created_at_ns=self._context.clock.wall_ns(),
        )
        return await self._context.storage.write(partial(_add, record=record))

    async def get(self, tenant: TenantId, webhook_id: str) -> WebhookRecord:
        """Raises NotFound."""
        return await self._context.storage.read(partial(_require, tenant=tenant, webhook_id=webhook_id))

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[WebhookRecord]:
        """The tenant's webhooks, oldest first."""
        return await self._context.lists.page(
            tenant,
            page,
            lambda uow, after, limit: uow.webhooks.find(tenant, after=after, limit=limit),
            as_it_is,
        )

    async def deliveries(self, tenant: TenantId, webhook_id: str, page: PageRequest) -> Page[DeliveryRecord]:
        """The last attempts to deliver, oldest first. Raises NotFound."""
        find = partial(_attempts, tenant=tenant, webhook_id=webhook_id)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def resume(self, tenant: TenantId, webhook_id: str) -> WebhookRecord:
        """Try again at once, also where it was suspended. Raises NotFound, Draining."""
        self._context.admission.require_running()
        return await self._context.storage.write(partial(_resume, tenant=tenant, webhook_id=webhook_id))

    async def delete(self, tenant: TenantId, webhook_id: str) -> None:
        """Send nothing more. Raises NotFound, Draining."""
        self._context.admission.require_running()
        await self._context.storage.write(partial(_delete, tenant=tenant, webhook_id=webhook_id))


def _add(uow: UnitOfWork, record: WebhookRecord) -> CreatedWebhook:
    known = uow.webhooks.get(record.tenant, record.webhook_id)
    if known is not None:
        require_same_content(known.content_hash, record.content_hash, f"webhook {record.webhook_id}")
        return CreatedWebhook(known, "", replay=True)
    if record.map_id is not None:
        require_map(uow, record.tenant, record.map_id)
    if uow.webhooks.count(record.tenant) >= limits.WEBHOOKS:
        raise QuotaReached(f"a tenant may have {limits.WEBHOOKS} webhooks: delete one first")
    added = uow.webhooks.add(record)
    return CreatedWebhook(added, added.secret, replay=False)


def _resume(uow: UnitOfWork, tenant: TenantId, webhook_id: str) -> WebhookRecord:
    known = _require(uow, tenant, webhook_id, hold=True)
    resumed = replace(known, state=WebhookState.ENABLED.value, failures=0, due_at_ns=0)
    uow.webhooks.replace(resumed)
    return resumed


def _delete(uow: UnitOfWork, tenant: TenantId, webhook_id: str) -> None:
    _require(uow, tenant, webhook_id, hold=True)
    uow.webhook_deliveries.delete(tenant, webhook_id=webhook_id)
    uow.webhooks.delete(tenant, webhook_id=webhook_id)


def _attempts(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, webhook_id: str) -> list[DeliveryRecord]:
    _require(uow, tenant, webhook_id)
    return uow.webhook_deliveries.find(tenant, after=after, limit=limit, webhook_id=webhook_id)


def _require(uow: UnitOfWork, tenant: TenantId, webhook_id: str, *, hold: bool = False) -> WebhookRecord:
    record = uow.webhooks.get(tenant, webhook_id, hold=hold)
    if record is None:
        raise NotFound(f"there is no webhook {webhook_id!r}"[:200])
    return record
