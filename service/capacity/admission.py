"""Whether a request is accepted now: not while the service stops, the disk is full, or a limit is reached."""

from __future__ import annotations

import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from revisit.service.capacity.backlog import Backlog
from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import CREATION_POINTS
from revisit.service.capacity.storage_quota import StorageQuota
from revisit.service.domain.errors import Draining, StorageFull
from revisit.service.domain.identity import TenantId
from revisit.service.ports.disk import DiskSpace


class Admission:
    """Refuses requests that the service cannot serve now."""

    def __init__(
        self,
        stopping: threading.Event,
        disk: DiskSpace,
        in_flight: InFlight,
        backlog: Backlog,
        quota: StorageQuota | None,
    ) -> None:
        """`stopping` is set when the service begins to stop; `quota` is None where tenants have no bound of storage."""
        self._stopping = stopping
        self._disk = disk
        self._in_flight = in_flight
        self._backlog = backlog
        self._quota = quota

    @property
    def stopping(self) -> bool:
        """Whether the service stops."""
        return self._stopping.is_set()

    def stop(self) -> None:
        """Refuse every new request from now on."""
        self._stopping.set()

    def require_running(self) -> None:
        """Raises Draining once the service is stopping."""
        if self.stopping:
            raise Draining

    def require_storage(self) -> None:
        """As `require_running`, for a request that stores a cloud. Raises also StorageFull while the disk is full."""
        self.require_running()
        if self._disk.full():
            raise StorageFull

    async def require_room(self, tenant: TenantId) -> None:
        """Raises QuotaReached where the tenant stores as much as it may."""
        if self._quota is not None:
            await self._quota.require_room(tenant)

    def note_stored(self, tenant: TenantId, points: int) -> None:
        """The tenant keeps so many points more."""
        if self._quota is not None:
            self._quota.note(tenant, points)

    def charge_call(self, tenant: TenantId, points: int) -> None:
        """Charge a request that takes as long as so many points. Raises RateLimited, and charges nothing."""
        self._in_flight.check_rate(tenant)
        self._in_flight.charge_call(tenant, points)

    def charge_creation(self, tenant: TenantId, rows_points: int = 0) -> None:
        """Charge a call that makes a lasting row, and so many points for those beside it.

        Raises Draining; RateLimited, and charges nothing.
        """
        self.require_running()
        self.charge_call(tenant, CREATION_POINTS + rows_points)

    def precheck_cloud(self, tenant: TenantId) -> None:
        """The checks before a cloud is read. Raises Draining, RateLimited, WorkersBusy."""
        self.require_running()
        self._in_flight.check_rate(tenant)
        self._in_flight.check_slot(tenant)

    async def precheck_job(self, tenant: TenantId) -> None:
        """As `precheck_cloud`, for a cloud that becomes a job. Raises also WorkersBusy where the backlog is full."""
        self.precheck_cloud(tenant)
        await self._backlog.precheck(tenant)

    @asynccontextmanager
    async def cloud(
        self, tenant: TenantId, *, refused_points: int = 0, patient: bool = False, queued: bool = True
    ) -> AsyncIterator[Callable[[int], None]]:
        """Reserve capacity for one cloud, which becomes a job if it is `queued`; see `InFlight.reserve_cloud`.

        Raises RateLimited; WorkersBusy where the backlog is full or, unless `patient`, all slots are taken.
        """
        self._in_flight.check_rate(tenant)
        if queued:
            await self._backlog.precheck(tenant)
        async with self._in_flight.reserve_cloud(tenant, refused_points, patient=patient) as decoded:
            yield decoded
