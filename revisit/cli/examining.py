"""doctor: whether everything is here that the product needs, and whether it answers."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import typer

from revisit.cli.output import emit_json, emit_table
from revisit.core.errors import RevisitError
from revisit.sdk.client import Client
from revisit.sdk.errors import ApiError
from revisit.sdk.retry import RetryPolicy
from revisit.service.adapters.sqlite.examination import Finding, examine

LIBRARIES = ("numpy", "torch", "faiss-cpu", "opencv-python-headless", "fastapi", "grpcio", "protobuf", "sqlalchemy")


def doctor(home: Path | None, http: str, grpc: str, as_json: bool, full: bool = False) -> None:
    """Run every check; exit status 1 where one failed. `full` reads every blob instead of a sample."""
    once = RetryPolicy(attempts=1)
    findings = [
        Finding("python", True, platform.python_version()),
        *(_library(name) for name in LIBRARIES),
        _checked("models", _models),
        *_data(home, full),
        _checked("REST", lambda: _answer(Client(http, retry=once))),
        _checked("gRPC", lambda: _answer(Client.grpc(grpc, retry=once))),
    ]
    if as_json:
        emit_json([asdict(finding) for finding in findings])
    else:
        marks = {True: "ok", False: "FAILED", None: "-"}
        emit_table("Doctor", ("check", "", "detail"), [(f.check, marks[f.ok], f.detail) for f in findings])
    if any(finding.ok is False for finding in findings):
        raise typer.Exit(1)


def _library(name: str) -> Finding:
    try:
        return Finding(name, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Finding(name, False, "not installed")


def _checked(check: str, examine: Callable[[], str]) -> Finding:
    try:
        return Finding(check, True, examine())
    except (ApiError, RevisitError, OSError, ImportError, ValueError, RuntimeError) as error:
        return Finding(check, False, str(error)[:200])


def _models() -> str:
    from revisit.core.model_bundle import load_packaged_models

    return load_packaged_models().version


def _data(home: Path | None, full: bool) -> list[Finding]:
    from revisit.service.settings import Settings

    return examine(Settings(home=home).home if home else Settings().home, full=full)


def _answer(client: Client) -> str:
    with client:
        status = client.status()
    return f"version {status.version}, {len(status.workers)} workers, {status.queued_jobs} jobs waiting"
