"""How much a tenant may store, by the points of its clouds, by its anchors and by its plans.

Counted from rows: 12 bytes a point, as a cloud has them before it is compressed, so that a client can reckon with it;
an anchor and a reading of radio count as so many points, a plan as the bytes of its picture. Derived data (meshes,
descriptors) is not counted. A gateway keeps a sum in memory. It makes the sum anew, at most once a second a tenant,
once it has stored its part of the room that there was: the other gateways may have filled theirs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from revisit.service.capacity.budget import GatewayShare
from revisit.service.capacity.limits import (
    POINT_BYTES,
    QUOTA_RECOUNT_S,
    QUOTA_RETRY_S,
    STORED_ANCHOR_POINTS,
    STORED_READING_POINTS,
)
from revisit.service.domain.errors import QuotaReached
from revisit.service.domain.identity import TenantId
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork


@dataclass
class _Stored:
    """Bytes of a tenant as they were counted, by all gateways, and those that this one has stored since."""

    counted: int
    since: int = 0


class StorageQuota:
    """Stored bytes of each tenant, as last counted, and the limit."""

    def __init__(
        self,
        storage: Storage,
        most_bytes: int,
        share: GatewayShare | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """A tenant stores at most `most_bytes`; clouds under way may go beyond it."""
        self._storage = storage
        self._most_bytes = most_bytes
        self._share = share or GatewayShare()
        self._now_s = now_s
        self._stored: dict[TenantId, _Stored] = {}
        self._counted_s: dict[TenantId, float] = {}

    async def require_room(self, tenant: TenantId) -> None:
        """Raises QuotaReached."""
        if self._is_to_count(tenant) and self._now_s() >= self._counted_s.get(tenant, 0.0) + QUOTA_RECOUNT_S:
            self._counted_s[tenant] = self._now_s()
            counted = await self._storage.read(lambda uow: _points(uow, tenant))
            self._stored[tenant] = _Stored(POINT_BYTES * counted)
        if self._reached(tenant):
            most = f"{self._most_bytes >> 20} MiB"
            message = f"the tenant's clouds, anchors and plans take {most} or more, which is all it may store"
            raise QuotaReached(message, retry_after_s=QUOTA_RETRY_S)

    def note(self, tenant: TenantId, points: int) -> None:
        """So many points more are being stored."""
        if tenant in self._stored:
            self._stored[tenant].since += POINT_BYTES * points

    def _is_to_count(self, tenant: TenantId) -> bool:
        """Whether this gateway has stored its part of the room that there was."""
        stored = self._stored.get(tenant)
        return stored is None or stored.since >= self._share.of(self._most_bytes - stored.counted)

    def _reached(self, tenant: TenantId) -> bool:
        """Also for a tenant that was not counted yet."""
        stored = self._stored.get(tenant)
        return stored is None or stored.counted + stored.since >= self._most_bytes


def _points(uow: UnitOfWork, tenant: TenantId) -> int:
    clouds = uow.scans.points_of(tenant) + uow.submaps.points_of(tenant)
    anchors = STORED_ANCHOR_POINTS * uow.anchors.count(tenant)
    plans = uow.plans.bytes_of(tenant) // POINT_BYTES
    return clouds + anchors + plans + STORED_READING_POINTS * uow.radio_readings.count(tenant)
