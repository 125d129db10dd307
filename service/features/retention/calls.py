"""The policy of retention of a map: read it, set it, and ask what it would remove."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

from revisit.service.capacity.in_flight import Turns
from revisit.service.domain.identity import TenantId
from revisit.service.domain.retention import RetentionPolicy
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.retention.preview import Preview
from revisit.service.features.retention.reports import MapRetention, RetentionReport
from revisit.service.features.retention.rows import retention_of
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

PREVIEW_POINTS = 5_000_000
"""A dry run reads a whole map: as much as half a second of a core, in points of a cloud."""


class MapRetentions:
    """Get, set and try policies of retention."""

    def __init__(self, context: CallContext) -> None:
        """The policy of the service is that of maps without one of their own."""
        self._context = context
        self._turns = Turns(1)

    async def get(self, tenant: TenantId, map_id: str) -> MapRetention:
        """The policy of a map and the last run. Raises NotFound."""
        record = await self._context.storage.read(partial(require_map, tenant=tenant, map_id=map_id))
        return retention_of(record, self._context.policy)

    async def set(self, tenant: TenantId, map_id: str, policy: RetentionPolicy | None) -> MapRetention:
        """Give a map a policy of its own, None: that of the service; it is followed from the next run on.

        Raises NotFound, BadField, Draining, RateLimited.
        """
        self._context.admission.charge_creation(tenant)
        text = None if policy is None else str(policy.validated())
        entry = audit.noted(tenant, "retention_set", f"maps/{map_id}", policy=text)
        work = partial(self._set, tenant=tenant, map_id=map_id, text=text, entry=entry)
        return await self._context.storage.write(work)

    def _set(self, uow: UnitOfWork, tenant: TenantId, map_id: str, text: str | None, entry: AuditEntry) -> MapRetention:
        record = replace(require_map(uow, tenant, map_id), retention=text)
        uow.maps.replace(record)
        audit.append(uow, self._context.clock.wall_ns(), entry)
        return retention_of(record, self._context.policy)

    async def preview(self, tenant: TenantId, map_id: str, policy: RetentionPolicy | None) -> RetentionReport:
        """What a policy, None: that of the map, would remove now. Raises NotFound, BadField, RateLimited."""
        if policy is not None:
            policy.validated()
        record = await self._context.storage.read(partial(require_map, tenant=tenant, map_id=map_id))
        self._context.admission.charge_call(tenant, PREVIEW_POINTS)
        asked = (
            self._context.storage.transactions,
            self._context.storage.blobs,
            self._context.policy,
            record,
            policy or self._context.policy.kept_of(record),
        )
        async with self._turns.of(tenant):
            return await asyncio.to_thread(Preview(*asked).report, self._context.clock.wall_ns())
