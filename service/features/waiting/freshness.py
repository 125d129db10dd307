"""Read-your-writes: a query that names a sequence number is answered from everything stored up to it, or not at all."""

from __future__ import annotations

import time
from dataclasses import dataclass

from revisit.service.capacity.admission import Admission
from revisit.service.capacity.call_slots import Wait, waiting
from revisit.service.domain import limits
from revisit.service.domain.errors import SeqNotReached
from revisit.service.domain.identity import TenantId
from revisit.service.features.waiting.shared_poll import SharedPoll
from revisit.service.ports.storage import Storage, require_map
from revisit.service.ports.transactions import UnitOfWork

MAX_WAIT_S = limits.WAIT_S.most
DEFAULT_WAIT_S = 10.0
_PAUSE_S = (0.005, 0.25)


@dataclass(frozen=True)
class Freshness:
    """A read barrier: the answer includes every submap of the map up to `min_seq`.

    Waits at most `timeout_s` (0 to 60 s); a `min_seq` of 0 disables it. With `loops` the answer also includes the loops
    of these submaps with those that entered the map before. A submap that failed is not waited for: its operation says
    why.
    """

    min_seq: int = 0
    timeout_s: float = DEFAULT_WAIT_S
    loops: bool = False

    def validated(self) -> Freshness:
        """Itself. Raises BadField."""
        limits.MIN_SEQ.validated(self.min_seq, "min_seq")
        limits.WAIT_S.validated(self.timeout_s, "min_seq_timeout_s")
        return self


class ReadYourWrites:
    """Waits for read barriers."""

    def __init__(self, storage: Storage, admission: Admission) -> None:
        """Waiting ends when `admission` says that the service stops."""
        self._storage = storage
        self._admission = admission
        self._polls = SharedPoll(storage, _not_described)

    async def reached(self, tenant: TenantId, map_id: str, wanted: Freshness) -> None:
        """Return once all reads from now on satisfy `wanted`.

        Raises SeqNotReached after the time allowed, or at once for a number that no submap of the map was given;
        Draining where the service stops meanwhile; RateLimited where too many wait; NotFound for the map.
        """
        min_seq = wanted.validated().min_seq
        if min_seq == 0:
            return
        if await self._storage.read(lambda uow: _last(uow, tenant, map_id)) < min_seq:
            raise SeqNotReached(f"no submap with seq {min_seq} was stored", field="min_seq")
        of = tenant, map_id, wanted.loops
        if await self._polls.has_come(of, min_seq, 0.0):
            return
        with waiting() as wait:
            if not await self._comes(of, wanted, wait):
                lack = "compared" if wanted.loops else "described"
                raise SeqNotReached(
                    f"submaps up to seq {min_seq} are not {lack} after {wanted.timeout_s:g} s", field="min_seq"
                )

    async def _comes(self, of: tuple[TenantId, str, bool], wanted: Freshness, wait: Wait) -> bool:
        """Whether the barrier is reached in the time allowed, while somebody waits for it. Raises Draining."""
        deadline, pause = time.monotonic() + wanted.timeout_s, _PAUSE_S[0]
        while (left := deadline - time.monotonic()) > 0.0 and not wait.abandoned:
            self._admission.require_running()
            if await self._polls.has_come(of, wanted.min_seq, min(pause, left)):
                return True
            pause = min(pause * 1.5, _PAUSE_S[1])
        return False


def _last(uow: UnitOfWork, tenant: TenantId, map_id: str) -> int:
    require_map(uow, tenant, map_id)
    return uow.submaps.last_seq(tenant, map_id)


def _not_described(uow: UnitOfWork, of: tuple[TenantId, str, bool], min_seqs: frozenset[int]) -> frozenset[int]:
    """Those numbers up to which a submap of the map waits, or its loops do. Raises NotFound."""
    tenant, map_id, loops = of
    require_map(uow, tenant, map_id)
    waiting = [uow.submaps.first_waiting(tenant, map_id)]
    if loops:
        waiting.append(uow.submaps.first_unsearched(tenant, map_id))
    first = min((number for number in waiting if number is not None), default=None)
    return frozenset(() if first is None else (min_seq for min_seq in min_seqs if first <= min_seq))
