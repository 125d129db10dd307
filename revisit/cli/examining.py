"""doctor: whether everything is here that the product needs, and whether it answers."""

from __future__ import annotations

import platform
import sqlite3
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

import typer

from core.errors import RevisitError
from revisit.cli.output import emit_json, emit_table
from revisit.client import Client
from revisit.errors import ApiError
from revisit.retry import RetryPolicy

LIBRARIES = ("numpy", "torch", "faiss-cpu", "opencv-python-headless", "fastapi", "grpcio", "protobuf", "sqlalchemy")


@dataclass(frozen=True)
class Finding:
    """One check. `ok` is None where it does not apply."""

    check: str
    ok: bool | None
    detail: str


def doctor(home: Path | None, http: str, grpc: str, as_json: bool) -> None:
    """Run every check; exit status 1 where one failed."""
    once = RetryPolicy(attempts=1)
    findings = [
        Finding("python", True, platform.python_version()),
        *(_library(name) for name in LIBRARIES),
        _checked("models", _models),
        _database(home),
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
    from core.model_bundle import load_packaged_models

    return load_packaged_models().version


def _database(home: Path | None) -> Finding:
    from service.settings import Settings

    file = Settings(home=home).database if home else Settings().database
    if not file.exists():
        return Finding("database", None, f"{file} does not exist yet")
    try:
        with sqlite3.connect(f"file:{file}?mode=ro", uri=True) as connection:
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        return Finding("database", False, f"{file}: {error}")
    return Finding("database", verdict == "ok", f"{file}: {verdict}")


def _answer(client: Client) -> str:
    with client:
        status = client.status()
    return f"version {status.version}, {len(status.workers)} workers, {status.queued_jobs} jobs waiting"
