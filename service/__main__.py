"""`python -m revisit.service serve | worker | workers | search | ...`: settings come from REVISIT_* variables."""

from __future__ import annotations

import argparse
import asyncio
import gc
import multiprocessing
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from revisit.service import ONE_THREAD, VERSION
from revisit.service.worker.optional_libraries import leave_out_optional_libraries

if TYPE_CHECKING:
    from revisit.service.engines.state import State
    from revisit.service.settings import Settings

CONFIGURATION = 78
"""Exit status for settings that cannot be used (EX_CONFIG)."""

NOT_NOW = 75
"""Exit status where another gateway serves the data folder, or the database or the store of blobs does not answer
(EX_TEMPFAIL): a moment later it may be otherwise.
"""


def main(arguments: list[str] | None = None) -> int:
    """Run a command; the exit status."""
    # Before any of the libraries is imported.
    for variable, threads in ONE_THREAD.items():
        os.environ.setdefault(variable, threads)
    # Workers are started afresh (fork and exec at once), so gRPC need not prepare for a forked copy of itself.
    os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")
    # Processes that libraries start are started afresh too: a copy of a process with threads may hang.
    multiprocessing.set_start_method("spawn", force=True)
    # Files are for this user only.
    os.umask(0o077)
    options = _parser().parse_args(arguments)
    if options.command in ("serve", "worker"):
        leave_out_optional_libraries()
    if options.command == "unit":
        print(_unit(), end="")
        return 0
    from revisit.service.failpoints import arm
    from revisit.service.settings_loading import UnusableSettings, load_settings
    from revisit.service.telemetry import configure_logging

    try:
        settings = load_settings()
        configure_logging(settings.log_level, hash_tenants=settings.hash_tenants_in_logs)
    except UnusableSettings as error:
        return _refuse(str(error))
    except ValueError as error:
        return _refuse(f"REVISIT_LOG_LEVEL: {error}")
    try:
        arm(settings.for_tests.fail)
    except ValueError as error:
        return _refuse(f"REVISIT_FOR_TESTS: {error}")
    return _started(options, settings)


def _started(options: argparse.Namespace, settings: Settings) -> int:
    """Run the command; unusable input is refused in a line."""
    from revisit.core.errors import MissingLibrary
    from revisit.service.domain.errors import StorageUncertain
    from revisit.service.engines.local.files.filesystem import RemoteFileSystem
    from revisit.service.engines.schema import ForeignSchema, UnusableServer
    from revisit.service.engines.state import state_of

    try:
        state = state_of(settings.home, settings.database_url)
        return _run(options, settings, state)
    except ForeignSchema as error:
        return _refuse(f"the database {state.name} does not fit this version: {error}")
    except (RemoteFileSystem, UnusableServer, MissingLibrary) as error:
        return _refuse(str(error))
    except StorageUncertain as error:
        print(f"{state.name}: {error.reason}", file=sys.stderr)
        return NOT_NOW


def _run(options: argparse.Namespace, settings: Settings, state: State) -> int:
    """Run the command that was asked for; the exit status.

    Raises ForeignSchema for a database of another version.
    """
    broken = state.broken()
    if broken:
        return _refuse(
            f"{state.name} cannot be read: {broken}. `revisit restore` makes a data folder of a backup; "
            "REVISIT_HOME names it"
        )
    if options.command == "migrate":
        state.migrate(options.revision)
        return 0
    if options.command == "serve":
        return _serve(settings, state)
    if not state.is_made():
        return _refuse(f"there is no database at {state.name} yet: run `python -m revisit.service migrate` first")
    from revisit.service.compiled_kernels import choose_cache

    choose_cache(settings.home)
    if options.command in ("worker", "workers"):
        _tell_start(options.command)
    if options.command == "search":
        return _search(settings)
    if options.command == "worker":
        gc.disable()  # until it takes jobs, as in `_serve`
    from revisit.service.composition import run_worker, worker_seen

    if options.command == "seen":
        return 0 if worker_seen(settings, options.id) else _refuse(f"worker {options.id} has not shown itself lately")
    if options.command == "workers":
        from revisit.service.worker_host import run_workers

        return run_workers(settings)
    try:
        run_worker(settings, options.id, options.parent)
    finally:
        gc.enable()
    return 0


def _search(settings: Settings) -> int:
    """Run a search process; the exit status."""
    from revisit.service.composition import run_search

    _tell_start("search")
    try:
        return run_search(settings)
    except (OSError, ValueError) as error:
        return _refuse(str(error))


def _tell_start(command: str) -> None:
    """The first line of the log: the next imports take seconds."""
    import structlog  # not before a worker has hidden optional libraries

    structlog.get_logger(__name__).info("starting", command=command, version=VERSION)


def _unit() -> str:
    """The unit file for systemd, which starts the Python that runs now."""
    text = (Path(__file__).parent / "systemd" / "revisit.service").read_text()
    return text.replace("/opt/revisit/.venv/bin/python", sys.executable)


def _serve(settings: Settings, state: State) -> int:
    """Run the gateway, where its address is safe to listen on and no other serves the data folder; the exit status."""
    missing = _missing_protection(settings, state)
    if missing:
        return _refuse(
            f"refusing to listen on {settings.host}, which others can reach, without {' and '.join(missing)}. "
            "Listen on 127.0.0.1, or set REVISIT_INSECURE_BIND=1 if you mean it."
        )
    _tell_start("serve")
    gc.disable()  # nothing that a start makes is garbage: until the gateway serves nobody looks for it
    from revisit.service.compiled_kernels import choose_cache
    from revisit.service.engines.local.files.home_lock import HomeTaken
    from revisit.service.engines.stored_blobs import BlobStoreUnusable

    try:
        # Before numba is imported: the gateway has kernels, too.
        choose_cache(settings.home)
        with state.sole_gateway():  # before the imports, which take a second: a gateway too many is told at once
            from revisit.service.gateway import serve

            return serve(settings, state)
    except HomeTaken as error:
        print(error, file=sys.stderr)
        return NOT_NOW
    except BlobStoreUnusable as error:
        print(error, file=sys.stderr)
        return CONFIGURATION if error.for_good else NOT_NOW
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.filename is not None:
            return _refuse(f"cannot use {error.filename}: {error.strerror}; REVISIT_HOME names the data folder")
        return _refuse(f"cannot serve on {settings.host}: {error}")
    finally:
        gc.enable()


def _missing_protection(settings: Settings, state: State) -> list[str]:
    """Missing protections of an address that others can reach; none where that was asked for."""
    if not settings.exposed or settings.insecure_bind:
        return []
    missing = [] if settings.tls_certificate else ["TLS (REVISIT_TLS_CERTIFICATE, REVISIT_TLS_KEY)"]
    if not settings.knows_callers_without_keys and not _has_live_key(settings, state):
        missing.append("an API key (`revisit keys create`)")
    return missing


def _has_live_key(settings: Settings, state: State) -> bool:
    if not state.is_made():
        return False
    from revisit.service.composition import offline_use_cases

    state.migrate()
    with offline_use_cases(settings) as use_cases:
        return asyncio.run(use_cases.keys.any_live())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m revisit.service", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("unit", help="print the unit file for systemd")
    commands.add_parser("serve", help="run the gateway (REST and gRPC) and its workers")
    commands.add_parser("search", help="run a search process, which holds the indices of maps for all others")
    commands.add_parser("workers", help="run the workers of this machine without a gateway, on PostgreSQL")
    worker = commands.add_parser("worker", help="run one more worker on this machine")
    worker.add_argument("--id", help="name of the worker; one is made up by default")
    worker.add_argument("--parent", type=int, help="end with the process of this id")
    seen = commands.add_parser("seen", help="exit with 0 if a worker has shown itself lately, for health checks")
    seen.add_argument("--id", required=True, help="name of the worker")
    migrate = commands.add_parser("migrate", help="bring the database to the schema of this version")
    migrate.add_argument("--revision", default="head", help="a revision to go back to, or base; default head")
    return parser


def _refuse(message: str) -> int:
    print(message, file=sys.stderr)
    return CONFIGURATION


if __name__ == "__main__":
    sys.exit(main())
