"""Read-your-writes: a query that names a sequence number is answered from everything stored up to it, or not at all."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

from revisit.service.application.capacity.admission import Admission
from revisit.service.application.contract import limits
from revisit.service.application.contract.errors import SeqNotReached
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.storage import Storage, require_map
from revisit.service.application.contract.transactions import UnitOfWork

MAX_WAIT_S = limits.WAIT_S.most
DEFAULT_WAIT_S = 10.0
_POLL_S = (0.005, 0.25)


@dataclass(frozen=True)
class Freshness:
    """What an answer must rest on: every submap of the map whose `seq` is at most `min_seq`.

    It is waited for up to `timeout_s` (0 to 60 s). 0 asks for nothing. A submap whose description failed is not waited
    for: its operation says why.
    """

    min_seq: int = 0
    timeout_s: float = DEFAULT_WAIT_S

    def validated(self) -> Freshness:
        """Itself. Raises BadField."""
        limits.MIN_SEQ.validated(self.min_seq, "min_seq")
        limits.WAIT_S.validated(self.timeout_s, "min_seq_timeout_s")
        return self


async def await_freshness(
    storage: Storage, admission: Admission, tenant: TenantId, map_id: str, wanted: Freshness
) -> None:
    """Return once whatever is read from now on holds what is `wanted`.

    Raises SeqNotReached after the time allowed, or at once for a number beyond the tenant's own submaps, whether or not
    somebody else has it; Draining where the service stops meanwhile; NotFound for the map.
    """
    if wanted.validated().min_seq == 0:
        return
    if await storage.read(lambda uow: _last(uow, tenant, map_id)) < wanted.min_seq:
        raise SeqNotReached(f"no submap with seq {wanted.min_seq} was stored", field="min_seq")
    deadline, pause = time.monotonic() + wanted.timeout_s, _POLL_S[0]
    while waiting := await storage.read(lambda uow: _waiting(uow, tenant, map_id, wanted.min_seq)):
        admission.require_running()
        left = deadline - time.monotonic()
        if left <= 0.0:
            message = f"{waiting} submaps up to seq {wanted.min_seq} are not described after {wanted.timeout_s:g} s"
            raise SeqNotReached(message, field="min_seq")
        await asyncio.sleep(min(pause, left))
        pause = min(pause * 1.5, _POLL_S[1])


def _last(uow: UnitOfWork, tenant: TenantId, map_id: str) -> int:
    require_map(uow, tenant, map_id)
    return uow.submaps.last_number(tenant)


def _waiting(uow: UnitOfWork, tenant: TenantId, map_id: str, min_seq: int) -> int:
    require_map(uow, tenant, map_id)
    return uow.submaps.waiting_up_to(tenant, map_id, min_seq)
