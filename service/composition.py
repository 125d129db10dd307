"""Builds everything once; nothing else constructs adapters."""

from __future__ import annotations

import importlib
import os
import secrets
import signal
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import structlog

from service import VERSION
from service.adapters.blobs import FileBlobStore
from service.adapters.clock import SystemClock
from service.adapters.sql.unit_of_work import SqlTransactions
from service.adapters.vector_index import PlaceVectorIndex
from service.application import Context, UseCases
from service.application.ports import PlaceRecogniser
from service.application.recognition import Recognition
from service.application.system import WORKER_SEEN_WITHIN_MS
from service.settings import Settings
from service.worker.loop import Worker, WorkerIdentity

if TYPE_CHECKING:
    from core.index import PlaceIndex

STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)

log = structlog.get_logger(__name__)


def build_context(settings: Settings, *, gateway: bool, on_uncertain: Callable[[], None] = lambda: None) -> Context:
    """The ports of a process. The gateway alone checkpoints the database; see `SqlTransactions` for `on_uncertain`."""
    policy = settings.policy
    transactions = SqlTransactions(
        settings.database, checkpoints=gateway, lease_ms=policy.lease_ms, on_uncertain=on_uncertain
    )
    return Context(
        transactions=transactions,
        blobs=FileBlobStore(settings.blobs),
        index=PlaceVectorIndex(_new_index),
        clock=SystemClock(),
        policy=policy,
    )


def build_use_cases(context: Context) -> UseCases:
    """What the transports call."""
    return UseCases.over(context, VERSION)


def run_worker(settings: Settings, worker_id: str | None, parent_pid: int | None) -> None:
    """Run one worker process until SIGTERM or SIGINT: at once while it loads, after its job later on."""
    for number in STOP_SIGNALS:
        # A handler of its own, for the kernel spares the first process of a container the default one.
        signal.signal(number, lambda number, _: os._exit(128 + number))
    log.info("worker_loading")
    recogniser = load_recogniser(settings.recogniser)
    stopping = threading.Event()
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: stopping.set())
    context = build_context(settings, gateway=False)
    identity = WorkerIdentity(worker_id or f"worker-{secrets.token_hex(4)}", recogniser.model_version, parent_pid)
    structlog.contextvars.bind_contextvars(worker=identity.worker_id)
    log.info("worker_ready", model_version=identity.model_version)
    worker = Worker(context, Recognition(context, recogniser), identity, stopping, settings.jobs_per_worker)
    try:
        worker.run()
    finally:
        context.transactions.close()


def worker_seen(settings: Settings, worker_id: str) -> bool:
    """Whether the worker has shown itself in the database lately."""
    context = build_context(settings, gateway=False)
    now = context.clock.instant()
    try:
        alive = context.transactions.read(lambda uow: uow.workers.alive(now.epoch, now.ms - WORKER_SEEN_WITHIN_MS))
        return any(worker.worker_id == worker_id for worker in alive.result())
    finally:
        context.transactions.close()


def load_recogniser(name: str) -> PlaceRecogniser:
    """What the function `module:function` returns."""
    module, _, function = name.partition(":")
    return cast(PlaceRecogniser, getattr(importlib.import_module(module), function)())


def _new_index(dimension: int) -> PlaceIndex:
    from core.index import FaissIndex

    return FaissIndex(dimension)
