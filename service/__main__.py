"""`python -m revisit.service serve | worker | seen | migrate | unit`: settings come from REVISIT_* variables."""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from revisit.service import ONE_THREAD, VERSION
from revisit.service.worker.optional_libraries import leave_out_optional_libraries

if TYPE_CHECKING:
    from revisit.service.settings import Settings

CONFIGURATION = 78
"""Exit status for settings that cannot be used (EX_CONFIG)."""

TAKEN = 75
"""Exit status where another gateway serves the data folder, or the store of blobs does not answer (EX_TEMPFAIL): a
moment later it may.
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
    if options.command == "worker":
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
    from revisit.service.engines.local.files.filesystem import RemoteFileSystem
    from revisit.service.engines.schema import ForeignSchema

    try:
        return _run(options, settings)
    except ForeignSchema as error:
        return _refuse(f"the database {settings.database} does not fit this version: {error}")
    except (RemoteFileSystem, MissingLibrary) as error:
        return _refuse(str(error))


def _run(options: argparse.Namespace, settings: Settings) -> int:
    """Run the command that was asked for; the exit status.

    Raises ForeignSchema for a database of another version.
    """
    from revisit.service.engines.local.sqlite.connections import unreadable
    from revisit.service.engines.local.sqlite.migration import current_revision, migrate

    broken = unreadable(settings.database)
    if broken:
        return _refuse(
            f"{settings.database} cannot be read: {broken}. `revisit restore` makes a data folder of a backup; "
            "REVISIT_HOME names it"
        )
    if options.command == "migrate":
        migrate(settings.database, options.revision)
        return 0
    if options.command == "serve":
        return _serve(settings)
    if current_revision(settings.database) is None:
        return _refuse(
            f"there is no database at {settings.database} yet: run `python -m revisit.service migrate` first"
        )
    from revisit.service.compiled_kernels import choose_cache

    choose_cache(settings.home)
    if options.command == "worker":
        _tell_start("worker")
    if options.command == "search":
        return _search(settings)
    from revisit.service.composition import run_worker, worker_seen

    if options.command == "seen":
        return 0 if worker_seen(settings, options.id) else _refuse(f"worker {options.id} has not shown itself lately")
    run_worker(settings, options.id, options.parent)
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


def _serve(settings: Settings) -> int:
    """Run the gateway, where its address is safe to listen on and no other serves the data folder; the exit status."""
    missing = _missing_protection(settings)
    if missing:
        return _refuse(
            f"refusing to listen on {settings.host}, which others can reach, without {' and '.join(missing)}. "
            "Listen on 127.0.0.1, or set REVISIT_INSECURE_BIND=1 if you mean it."
        )
    _tell_start("serve")
    from revisit.service.compiled_kernels import choose_cache
    from revisit.service.engines.local.files.home_lock import HomeTaken, sole_gateway
    from revisit.service.engines.stored_blobs import BlobStoreUnusable

    try:
        # Before numba is imported: the gateway has kernels, too.
        choose_cache(settings.home)
        from revisit.service.gateway import serve

        with sole_gateway(settings.home):
            return serve(settings)
    except HomeTaken as error:
        print(error, file=sys.stderr)
        return TAKEN
    except BlobStoreUnusable as error:
        print(error, file=sys.stderr)
        return CONFIGURATION if error.for_good else TAKEN
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.filename is not None:
            return _refuse(f"cannot use {error.filename}: {error.strerror}; REVISIT_HOME names the data folder")
        return _refuse(f"cannot serve on {settings.host}: {error}")


def _missing_protection(settings: Settings) -> list[str]:
    """Missing protections of an address that others can reach; none where that was asked for."""
    if not settings.exposed or settings.insecure_bind:
        return []
    missing = [] if settings.tls_certificate else ["TLS (REVISIT_TLS_CERTIFICATE, REVISIT_TLS_KEY)"]
    if not settings.knows_callers_without_keys and not _has_live_key(settings):
        missing.append("an API key (`revisit keys create`)")
    return missing


def _has_live_key(settings: Settings) -> bool:
    if not settings.database.exists():
        return False
    from revisit.service.composition import offline_use_cases
    from revisit.service.engines.local.sqlite.migration import migrate

    migrate(settings.database)
    with offline_use_cases(settings) as use_cases:
        return asyncio.run(use_cases.keys.any_live())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m revisit.service", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("unit", help="print the unit file for systemd")
    commands.add_parser("serve", help="run the gateway (REST and gRPC) and its workers")
    commands.add_parser("search", help="run a search process, which holds the indices of maps for all others")
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
