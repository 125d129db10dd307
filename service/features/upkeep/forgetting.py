"""Forgetting: operations of queries by cloud are deleted some time after they ended, events once there are enough."""

from __future__ import annotations

from functools import partial

import structlog

from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

PORTION = 500
"""Rows that are deleted in one transaction: other writers get their turn in between."""

ANSWERS_KEPT_S = 24 * 3600.0
"""For so long the operation of a query by cloud can be read after its end, with the answer."""

EVENTS_KEPT = 50_000
"""Events of a tenant that are kept for watchers that were away: about four for each submap."""

WORKERS_KEPT_S = 3600.0
"""For so long a worker is remembered that was killed, and was no gateway's to watch."""

log = structlog.get_logger(__name__)


async def forget_answers(storage: Storage, clock: Clock, kept_s: float = ANSWERS_KEPT_S) -> int:
    """Delete the operations of queries that ended more than `kept_s` seconds ago; how many."""
    before_ns, forgotten = clock.wall_ns() - int(kept_s * 1e9), 0
    while portion := await storage.write(partial(_forget, before_ns=before_ns)):
        forgotten += portion
    if forgotten:
        log.info("answers_forgotten", operations=forgotten)
    return forgotten


def _forget(uow: UnitOfWork, before_ns: int) -> int:
    return uow.jobs.forget_answers(before_ns, PORTION)


async def forget_workers(storage: Storage, silent_s: float = WORKERS_KEPT_S) -> int:
    """Forget workers that have not shown themselves for so long, and that nobody has ended; how many."""
    silent = await storage.read(lambda uow: uow.workers.silent(int(1000 * silent_s)))
    for worker_id in silent:
        await storage.write(partial(_forget_worker, worker_id=worker_id))
    return len(silent)


def _forget_worker(uow: UnitOfWork, worker_id: str) -> None:
    uow.workers.forget(worker_id)
    uow.queue.release(worker_id, "its worker went silent")


async def forget_events(storage: Storage, kept: int = EVENTS_KEPT) -> int:
    """Delete all but the last `kept` events of each tenant; how many."""
    forgotten = await storage.write(lambda uow: uow.events.forget(kept))
    if forgotten:
        log.info("events_forgotten", events=forgotten)
    return forgotten
