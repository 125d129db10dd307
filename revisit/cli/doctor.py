"""`revisit doctor`: whether everything is here that the product needs, and whether it answers."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.api.words import NO_WORKER
from revisit.cli.extras import needs
from revisit.cli.offline import bucket_of, data_folder
from revisit.cli.options import GRPC, HTTP, Grpc, Home, Http, Json
from revisit.cli.output import emit_json, emit_table
from revisit.core.errors import RevisitError
from revisit.sdk.errors import ApiError

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Status
    from revisit.service.engines.findings import Finding
    from revisit.service.engines.stored_blobs import Bucket

FITS = "its schema fits"

LIBRARIES = ("numpy", "faiss-cpu", "opencv-python-headless", "fastapi", "grpcio", "protobuf", "sqlalchemy")


@needs("service")
def doctor(
    home: Home = None,
    http: Http = HTTP,
    grpc: Grpc = GRPC,
    full: Annotated[bool, typer.Option("--full", help="Read every row, and all blobs instead of 200.")] = False,
    json: Json = False,
) -> None:
    """Check versions, the models, the data folder and whether the service answers."""
    from revisit.sdk.client import Client
    from revisit.sdk.retry import RetryPolicy
    from revisit.service.engines.findings import Finding

    once = RetryPolicy(attempts=1)
    findings = [
        Finding("python", True, platform.python_version()),
        *(_library(name) for name in LIBRARIES),
        _library("torch", optional=True),
        _checked("models", _models),
        *_data(home, full),
        *_answers(lambda: Client(http, retry=once), lambda: Client.grpc(grpc, http=http, retry=once)),
    ]
    if json:
        emit_json([asdict(finding) for finding in findings])
    else:
        marks = {True: "ok", False: "FAILED", None: "-"}
        emit_table("Doctor", ("check", "", "detail"), [(f.check, marks[f.ok], f.detail) for f in findings])
    if any(finding.ok is False for finding in findings):
        raise typer.Exit(1)


def _library(name: str, optional: bool = False) -> Finding:
    from revisit.service.engines.findings import Finding

    try:
        return Finding(name, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Finding(name, None if optional else False, "not installed")


def _checked(check: str, examine: Callable[[], str]) -> Finding:
    from revisit.service.engines.findings import Finding

    try:
        return Finding(check, True, examine())
    except (ApiError, RevisitError, OSError, ImportError, ValueError, RuntimeError) as error:
        return Finding(check, False, str(error)[:200])


def _models() -> str:
    from revisit.core.model_bundle import load_packaged_models

    return load_packaged_models().version


def _data(home: Path | None, full: bool) -> list[Finding]:
    from revisit.service.engines.local.sqlite.examination import examine
    from revisit.service.settings_loading import load_settings

    bucket = bucket_of(home)
    if load_settings(home).database_url:
        return list(_shared_data(home, bucket, full))
    return examine(data_folder(home), full=full, bucket=bucket)


def _shared_data(home: Path | None, bucket: Bucket | None, full: bool) -> Iterator[Finding]:
    from revisit.service.engines.findings import examine_bucket
    from revisit.service.engines.local.sqlite.examination import blob_reader, quarantine
    from revisit.service.settings_loading import load_settings

    settings = load_settings(home)
    schema = _checked("database", lambda: _server(home))
    findings = [schema, *examine_bucket(bucket)]
    yield from findings
    if all(finding.ok is not False for finding in findings) and FITS in schema.detail:
        from revisit.service.engines.postgres.connections import server_url
        from revisit.service.engines.postgres.examination import examine

        yield from examine(server_url(settings.database_url), blob_reader(settings.home, bucket), full=full)
    yield quarantine(settings.home, bucket)


def _server(home: Path | None) -> str:
    from revisit.service.engines.schema import ForeignSchema, UnusableServer
    from revisit.service.engines.state import state_of
    from revisit.service.settings_loading import load_settings

    settings = load_settings(home)
    try:
        state = state_of(settings.home, settings.database_url)
        return f"{state.name}: {FITS if state.is_made() else 'empty yet'}"
    except (ForeignSchema, UnusableServer) as error:
        raise ValueError(str(error)) from error


def _answers(rest: Callable[[], Client], grpc: Callable[[], Client]) -> Iterator[Finding]:
    """Whether the service answers over both, and, where it does, whether a worker is ready."""
    from revisit.service.engines.findings import Finding

    told: list[Status] = []
    yield _checked("REST", lambda: _answer(rest(), told))
    yield _checked("gRPC", lambda: _answer(grpc(), told))
    if told:
        workers = len(told[-1].workers)
        yield Finding("workers", workers > 0, f"{workers} ready" if workers else NO_WORKER)


def _answer(client: Client, told: list[Status]) -> str:
    with client:
        told.append(client.status())
    return f"version {told[-1].version}, {told[-1].queued_jobs} jobs waiting"
