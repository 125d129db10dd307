"""Builds everything once; nothing else constructs adapters."""

from __future__ import annotations

import gc
import hashlib
import hmac
import importlib
import os
import secrets
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

import structlog

from revisit.core.config import Profile
from revisit.core.errors import MissingLibrary
from revisit.service import VERSION
from revisit.service.access_rules import access_rules
from revisit.service.adapters.core_map_merger import CoreMapMerger
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.adapters.core_tile_maker import CoreTileMaker
from revisit.service.capacity.budget import GatewayShare
from revisit.service.capacity.call_pace import CallPace
from revisit.service.capacity.in_flight import InFlight
from revisit.service.compiled_kernels import begin_anew_if_compiled
from revisit.service.context import ServiceContext
from revisit.service.domain.callers import current_actor
from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.files.disk import Disk, FailStop
from revisit.service.engines.local.files.file_drafts import FileDrafts
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.engines.local.files.secret_files import SECRET_BYTES, kept_secret
from revisit.service.engines.local.sqlite.connections import write_ahead_log
from revisit.service.engines.local.vector_index import SAVED_FROM, PlaceVectorIndex
from revisit.service.engines.state import state_of
from revisit.service.engines.stored_blobs import BlobStoreUnusable
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.recognition.reembedding import Reembedding
from revisit.service.features.upkeep.calls import WORKER_SEEN_WITHIN_MS
from revisit.service.features.webhooks.deliveries import Deliveries
from revisit.service.large_blocks import SPARE_BYTES, return_large_blocks, share_one_heap
from revisit.service.ports.blobs import BlobOutage, BlobStore, NoOutage
from revisit.service.ports.place_search import SearchElsewhere
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.tracing import NoTracer, Tracer
from revisit.service.ports.transactions import Transactions
from revisit.service.settings import Settings
from revisit.service.use_cases import UseCases
from revisit.service.worker.confinement import confine
from revisit.service.worker.exit_status import STORAGE_FAILED
from revisit.service.worker.heartbeat import WorkerIdentity
from revisit.service.worker.loading import logged_while_loading
from revisit.service.worker.loop import Worker, WorkerLimits

if TYPE_CHECKING:
    from revisit.core.index import PlaceIndex
    from revisit.service.engines.s3.blobs import S3BlobStore

PAGE_SECRET = "pages.key"
"""The file in the data folder that makes the tokens of pages good beyond a restart."""

DRAFTS = "reembedding"
"""The folder in the data folder with the drafts of `revisit reembed`."""

INDEX_FILES = "index"
"""The folder in the data folder of the files of large maps' indexes."""

NEWEST_CLOUDS = 5
"""Clouds of scans, and of submaps, that a start looks for in a bucket."""

STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)

log = structlog.get_logger(__name__)


def build_context(settings: Settings, *, gateway: bool, fail_stop: FailStop | None = None) -> ServiceContext:
    """The context of a process. The gateway alone checkpoints the database; a failing disk trips `fail_stop`."""
    policy, disk, switch = settings.policy, build_disk(settings), fail_stop or FailStop()
    share = GatewayShare()
    in_flight = InFlight(
        settings.capacity,
        current_actor,
        note_refused=lambda tenant, client: pace.note_refused(tenant, client),
        share=share,
    )
    pace = CallPace(others_wait=in_flight.others_wait, share=share)
    clock, state = SystemClock(), state_of(settings.home, settings.database_url)
    # Rows name one file of an index, which other machines would not have.
    files = IndexFiles(settings.home / INDEX_FILES) if state.on_this_machine else None
    transactions = state.transactions(
        gateway=gateway, lease_ms=policy.lease_ms, clock=clock, fail_stop=switch, on_full=disk.release
    )
    blobs, outage = build_blobs(settings, fail_stop=switch, on_full=disk.release)
    return ServiceContext(
        transactions=transactions,
        blobs=blobs,
        blob_outage=outage,
        index=PlaceVectorIndex(_new_index, files, saved_from=SAVED_FROM if gateway else None),
        clock=clock,
        policy=policy,
        share=share,
        in_flight=in_flight,
        pace=pace,
        disk=disk,
        secret=page_secret(settings),
        elsewhere=_search_elsewhere(settings, transactions),
    )


def _search_elsewhere(
    settings: Settings, transactions: Transactions
) -> Callable[[CaughtUpIndex], SearchElsewhere] | None:
    """The search in processes of the same secret, where there is one."""
    secret = settings.secret
    if secret is None:
        return None
    from revisit.service.search.client import RemotePlaceSearch  # needs gRPC, which workers of one machine do not load

    return lambda own: RemotePlaceSearch(transactions, secret.get_secret_value().encode(), own)


def build_blobs(
    settings: Settings, *, fail_stop: FailStop | None = None, on_full: Callable[[], None] = lambda: None
) -> tuple[BlobStore, BlobOutage]:
    """The store of the blobs. Raises MissingLibrary. `fail_stop` and `on_full` are for one in this machine's files."""
    if not settings.blob_url:
        return FileBlobStore(settings.blobs, fail_stop=fail_stop, on_full=on_full), NoOutage()
    store = bucket(settings)
    return store, store


def bucket(settings: Settings) -> S3BlobStore:
    """The bucket of `blob_url`. Raises MissingLibrary."""
    try:
        from revisit.service.engines.s3.blobs import S3BlobStore  # the extra `cluster`
    except ImportError as error:
        raise MissingLibrary("REVISIT_BLOB_URL needs obstore: install revisit-loops[cluster]") from error
    return S3BlobStore(settings.blob_url)


def require_bucket(settings: Settings) -> None:
    """Try the bucket of `blob_url` out, where there is one. Raises BlobStoreUnusable, MissingLibrary.

    It must hold one of the clouds that the newest rows name: another bucket would make every submap a damaged one.
    """
    if not settings.blob_url:
        return
    store = bucket(settings)
    if store.try_out():
        log.warning("bucket_keeps_versions", hint="a lifecycle rule must delete noncurrent versions")
    state = state_of(settings.home, settings.database_url)
    newest = state.newest_clouds(NEWEST_CLOUDS)
    if newest and not any(store.exists(blob.tenant, blob.kind, blob.sha256) for blob in newest):
        reason = f"it holds none of the {len(newest)} newest clouds of {state.name}: is it the right one?"
        raise BlobStoreUnusable(settings.blob_url, reason, for_good=True)


def page_secret(settings: Settings) -> bytes:
    """The key that encrypts page tokens. On a full disk it is kept in memory only, and the tokens end with it."""
    if settings.secret is not None:
        return hmac.digest(settings.secret.get_secret_value().encode(), PAGE_SECRET.encode(), hashlib.sha256)
    try:
        return kept_secret(settings.home / PAGE_SECRET)
    except (OSError, ValueError) as error:
        log.warning("page_secret_not_kept", reason=str(error))
        return secrets.token_bytes(SECRET_BYTES)


def build_disk(settings: Settings) -> Disk:
    """The disk of the data with its reserve."""
    return Disk(settings.home, settings.reserve_mb * 2**20, write_ahead_log(settings.database))


def supervisor_name(settings: Settings, role: str) -> str:
    """A name that a supervisor has again after a restart, and no other: of its host, its data folder and its role."""
    named = f"{role}:{socket.gethostname()}:{settings.home.resolve()}"
    return hashlib.sha256(named.encode()).hexdigest()[:8]


def build_deliveries(settings: Settings, context: ServiceContext) -> Deliveries:
    """The sender of webhooks."""
    from revisit.service.adapters.webhook_sender import HttpWebhookSender  # workers need none of its libraries
    from revisit.service.calls.push import webhook_body

    sender = HttpWebhookSender(private_networks=settings.webhook_private_networks)
    return Deliveries(context.storage, sender, context.clock, webhook_body)


def build_tracer(settings: Settings, process: str) -> Tracer:
    """The tracer of a process that is `gateway` or `worker`."""
    if not settings.otlp_endpoint:
        return NoTracer()
    from revisit.service.adapters.opentelemetry_tracer import otlp_tracer

    return otlp_tracer(settings.otlp_endpoint, process)


def build_use_cases(context: ServiceContext, settings: Settings) -> UseCases:
    """The use cases, for the transports. Raises ValueError where a file of the access rules cannot be used."""
    return UseCases.over(context, VERSION, access_rules(settings))


@contextmanager
def offline_use_cases(settings: Settings) -> Iterator[UseCases]:
    """The use cases on the database of a service that may or may not run, for the command line."""
    context = build_context(settings, gateway=False)
    try:
        yield UseCases.over(context, VERSION)
    finally:
        context.transactions.close()


@contextmanager
def offline_reembedding(settings: Settings) -> Iterator[Reembedding]:
    """Re-description of maps by the installed model, on the database of a service that may or may not run."""
    context = build_context(settings, gateway=False)
    recogniser, drafts = load_recogniser(settings.for_tests.recogniser), FileDrafts(settings.home / DRAFTS)
    try:
        yield Reembedding(context.transactions, context.blobs, context.policy, recogniser, drafts)
    finally:
        context.transactions.close()


def run_worker(settings: Settings, worker_id: str | None, parent_pid: int | None) -> None:
    """Run one worker process until SIGTERM or SIGINT: at once while it loads, after its job later on."""
    for number in STOP_SIGNALS:
        # A handler of its own, for the kernel spares the first process of a container the default one.
        signal.signal(number, lambda number, _: os._exit(128 + number))
    confine(settings.worker_memory_mb * 2**20)
    share_one_heap()
    return_large_blocks(SPARE_BYTES)
    log.info("worker_loading")
    with logged_while_loading(log.info):
        recogniser = load_recogniser(settings.for_tests.recogniser)
    begin_anew_if_compiled()
    stopping = threading.Event()
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: stopping.set())
    context = build_context(settings, gateway=False, fail_stop=FailStop(lambda: os._exit(STORAGE_FAILED)))
    model = recogniser.model_of(Profile.PRODUCT)
    identity = WorkerIdentity(worker_id or f"worker-{secrets.token_hex(4)}", model, parent_pid)
    structlog.contextvars.bind_contextvars(worker=identity.worker_id)
    log.info("worker_ready", model_version=identity.model_version)
    limits = WorkerLimits(
        settings.for_tests.jobs_per_worker, settings.worker_memory_mb * 2**20 * 3 // 4, settings.job_timeout_s
    )
    tracer = build_tracer(settings, "worker")
    worker = Worker(
        context,
        context.jobs(recogniser, CoreMapOptimiser(), CoreMapMerger(), CoreTileMaker()),
        identity,
        stopping,
        limits,
        tracer,
    )
    gc.enable()  # a start makes next to no garbage: whoever begins one looks for none
    try:
        worker.run()
    finally:
        tracer.close()
        context.transactions.close()


def run_search(settings: Settings) -> int:
    """Run a search process until SIGTERM or SIGINT; the exit status. Raises ValueError without a secret, OSError."""
    if settings.secret is None:
        raise ValueError("a search process answers those of the same REVISIT_SECRET: set it, everywhere the same")
    from revisit.service.search.process import HeldIndex, SearchService

    stopping = threading.Event()
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: stopping.set())
    context = build_context(settings, gateway=False)
    try:
        held = HeldIndex(context.storage, context.index, context.own_index)
        service = SearchService(held, settings.secret.get_secret_value().encode(), settings.host, settings.grpc_port)
        return service.run(stopping)
    finally:
        context.transactions.close()


def worker_seen(settings: Settings, worker_id: str) -> bool:
    """Whether the worker has shown itself in the database lately."""
    context = build_context(settings, gateway=False)
    try:
        alive = context.transactions.read(lambda uow: uow.workers.alive(WORKER_SEEN_WITHIN_MS))
        return any(worker.worker_id == worker_id for worker in alive.result())
    finally:
        context.transactions.close()


def load_recogniser(name: str) -> PlaceRecogniser:
    """The result of the function `module:function`."""
    module, _, function = name.partition(":")
    return cast(PlaceRecogniser, getattr(importlib.import_module(module), function)())


def _new_index(dimension: int) -> PlaceIndex:
    from revisit.core.index import FaissIndex

    return FaissIndex(dimension)
