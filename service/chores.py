"""The periodic work of a gateway: of its machine, of its index, and for the store, which one gateway does for all."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from revisit.service.composition import build_deliveries, build_disk
from revisit.service.context import ServiceContext
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.engines.local.sqlite.checkpoints import Checkpoints
from revisit.service.engines.local.sqlite.connections import write_ahead_log
from revisit.service.engines.local.sqlite.free_pages import FreePages
from revisit.service.engines.local.sqlite.transactions import StorageFailures
from revisit.service.engines.state import state_of
from revisit.service.features.retention.steady_time import SteadyTime
from revisit.service.features.upkeep.chores import Chore
from revisit.service.features.upkeep.forgetting import forget_answers, forget_events, forget_workers
from revisit.service.features.upkeep.gateways import SHOWN_EVERY_S, Gateways
from revisit.service.features.upkeep.sweeping import collect, sweep
from revisit.service.settings import Settings

TEND_DISK_EVERY_S = 0.5
FOLD_LOG_BACK_EVERY_S = 1.0
GIVE_BACK_EVERY_S = 5.0
SWEEP_EVERY_S = 6 * 3600.0
COLLECT_EVERY_S = 20.0
LOAD_INDEX_EVERY_S = 1.0
AUDIT_INDEX_EVERY_S = 1.0
TEND_INDEX_FILES_EVERY_S = 2.0
ERASE_EVERY_S = 5.0
RETAIN_EVERY_S = 600.0
FORGET_ANSWERS_EVERY_S = 60.0
FORGET_EVENTS_EVERY_S = 60.0
DELIVER_WEBHOOKS_EVERY_S = 1.0


def chores(settings: Settings, context: ServiceContext, fail_stop: FailStop) -> tuple[Chore, ...]:
    """The chores of a gateway; a failing disk trips `fail_stop`."""
    disk = build_disk(settings)
    tend = Chore("tend_disk", TEND_DISK_EVERY_S, partial(asyncio.to_thread, disk.tend))
    index, store = _of_index(context), _of_store(settings, context)
    if state_of(settings.home, settings.database_url).on_this_machine:
        failures = StorageFailures(write_ahead_log(settings.database), fail_stop, disk.release)
        fold = partial(asyncio.to_thread, Checkpoints(settings.database, failures).tend)
        folding = Chore("fold_log_back", FOLD_LOG_BACK_EVERY_S, fold, at_end=True)
        give = Chore("give_pages_back", GIVE_BACK_EVERY_S, partial(_give_back, FreePages(settings.database, failures)))
        return tend, folding, give, *index, *store
    gateways = Gateways(context.storage, context.share)
    show = Chore("show_gateway", SHOWN_EVERY_S, gateways.show, close=gateways.leave)
    return tend, show, *index, *(replace(chore, work=gateways.of_keeper(chore.work)) for chore in store)


async def _give_back(pages: FreePages) -> None:
    await asyncio.to_thread(pages.tend)


def _of_index(context: ServiceContext) -> Iterator[Chore]:
    """For the index of this process."""
    keeper = context.index_keeper()

    async def audit() -> None:
        await keeper.audit()

    async def tend_files() -> None:
        await keeper.tend_files()

    yield Chore("load_index", LOAD_INDEX_EVERY_S, keeper.load)
    yield Chore("audit_index", AUDIT_INDEX_EVERY_S, audit)
    yield Chore("tend_index_files", TEND_INDEX_FILES_EVERY_S, tend_files)


def _of_store(settings: Settings, context: ServiceContext) -> Iterator[Chore]:
    """For the store, whichever gateway does them."""
    deliveries = build_deliveries(settings, context)

    async def sweep_blobs() -> None:
        await sweep(context.storage)

    async def collect_blobs() -> None:
        await collect(context.storage)

    steady = SteadyTime(context.clock)

    async def retain() -> None:
        now_ns = steady.now_ns()
        if now_ns is not None:
            await context.retention.all(now_ns)

    async def forget() -> None:
        await forget_answers(context.storage, context.clock)
        await forget_workers(context.storage)

    async def forget_old_events() -> None:
        await forget_events(context.storage)

    yield Chore("sweep_blobs", SWEEP_EVERY_S, sweep_blobs)
    yield Chore("collect_blobs", COLLECT_EVERY_S, collect_blobs)
    yield Chore("erase_deleted", ERASE_EVERY_S, context.erasure.all, close=context.erasure.close)
    yield Chore("retention", RETAIN_EVERY_S, retain)
    yield Chore("forget_answers", FORGET_ANSWERS_EVERY_S, forget)
    yield Chore("forget_events", FORGET_EVENTS_EVERY_S, forget_old_events)
    yield Chore("deliver_webhooks", DELIVER_WEBHOOKS_EVERY_S, deliveries.deliver_due, close=deliveries.close)
