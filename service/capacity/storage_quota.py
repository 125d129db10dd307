"""How much a tenant may store, by the points of its clouds.

Counted from rows: 12 bytes a point, as a cloud has them before it is compressed, so that a client can reckon with it;
derived data (meshes, descriptors) is not counted. A sum is kept in memory and made anew where it says that
the quota is reached, at most once a second a tenant.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from revisit.service.capacity.limits import POINT_BYTES, QUOTA_RECOUNT_S, QUOTA_RETRY_S
from revisit.service.domain.errors import QuotaReached
from revisit.service.domain.identity import TenantId
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork


class StorageQuota:
    """Stored bytes of each tenant, as last counted, and the limit."""

    def __init__(self, storage: Storage, most_bytes: int, now_s: Callable[[], float] = time.monotonic) -> None:
        """A tenant stores at most `most_bytes`; clouds under way may go beyond it."""
        self._storage = storage
        self._most_bytes = most_bytes
        self._now_s = now_s
        self._stored: dict[TenantId, int] = {}
        self._counted_s: dict[TenantId, float] = {}

    async def require_room(self, tenant: TenantId) -> None:
        """Raises QuotaReached."""
        if self._reached(tenant) and self._now_s() >= self._counted_s.get(tenant, 0.0) + QUOTA_RECOUNT_S:
            self._counted_s[tenant] = self._now_s()
            self._stored[tenant] = POINT_BYTES * await self._storage.read(lambda uow: _points(uow, tenant))
        if self._reached(tenant):
            message = f"the tenant's clouds take {self._most_bytes >> 20} MiB or more, which is all it may store"
            raise QuotaReached(message, retry_after_s=QUOTA_RETRY_S)

    def note(self, tenant: TenantId, points: int) -> None:
        """So many points more are being stored."""
        if tenant in self._stored:
            self._stored[tenant] += POINT_BYTES * points

    def _reached(self, tenant: TenantId) -> bool:
        """Also for a tenant that was not counted yet."""
        stored = self._stored.get(tenant)
        return stored is None or stored >= self._most_bytes


def _points(uow: UnitOfWork, tenant: TenantId) -> int:
    return uow.scans.points_of(tenant) + uow.submaps.points_of(tenant)
