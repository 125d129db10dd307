"""keys and audit: who gets in, and what happened; both work on the database, whether or not the service runs."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from revisit.cli.output import emit_json, emit_table, refuse, say
from revisit.service.application import UseCases
from revisit.service.application.access.api_keys import CreateKey, NewKey
from revisit.service.application.contract.access_ports import AuditRecord, KeyRecord

DAY_S = 86400.0
HOUR_S = 3600.0


def create(home: Path | None, command: CreateKey, as_json: bool) -> None:
    """Make a key and show it, once."""
    with _service(home) as use_cases:
        _show_new(asyncio.run(use_cases.keys.create(command)), as_json)


def rotate(home: Path | None, key_id: str, grace_hours: float, as_json: bool) -> None:
    """Make the successor of a key and show it, once."""
    with _service(home) as use_cases:
        _show_new(asyncio.run(use_cases.keys.rotate(key_id, grace_hours * HOUR_S)), as_json)


def revoke(home: Path | None, key_id: str, as_json: bool) -> None:
    """End a key."""
    with _service(home) as use_cases:
        record = asyncio.run(use_cases.keys.revoke(key_id))
    if as_json:
        emit_json(_key_json(record))
    else:
        say(f"Key {key_id} opens nothing any more; open streams end within 30 s.")


def list_keys(home: Path | None, as_json: bool) -> None:
    """Show every key, without its secret."""
    with _service(home) as use_cases:
        keys = asyncio.run(use_cases.keys.all())
    if as_json:
        emit_json([_key_json(key) for key in keys])
        return
    rows = [
        (k.key_id, k.tenant, " ".join(k.scopes), k.label, _time(k.created_at_ns), _time(k.expires_at_ns),
         _time(k.revoked_at_ns))
        for k in keys
    ]  # fmt: skip
    emit_table("Keys", ("id", "tenant", "scopes", "label", "created", "expires", "revoked"), rows)


def list_audit(home: Path | None, limit: int, as_json: bool) -> None:
    """Show the newest rows of the audit log."""
    with _service(home) as use_cases:
        rows = asyncio.run(use_cases.audit.newest(limit))
    if as_json:
        emit_json([asdict(row) for row in rows])
        return
    table = [(r.number, _time(r.at_ns), r.tenant, r.actor, r.action, r.subject, _detail(r)) for r in rows]
    emit_table("Audit log", ("row", "time", "tenant", "actor", "action", "subject", "detail"), table)


def verify_audit(home: Path | None, expected: str, as_json: bool) -> None:
    """Check the chain of hashes; exit status 1 where it is broken, or does not hold the row noted earlier."""
    with _service(home) as use_cases:
        verdict = asyncio.run(use_cases.audit.verify())
        if expected and verdict.fault is None and not asyncio.run(use_cases.audit.holds(*_noted(expected))):
            raise refuse(f"the log is not the one that {expected} was noted from")
    if as_json:
        emit_json(asdict(verdict))
    elif verdict.fault is None:
        say(f"{verdict.rows} rows, each bound to the one before. Note the last one elsewhere: {_head(verdict)}")
    if verdict.fault is not None:
        raise refuse(f"the audit log was tampered with: {verdict.fault}")


@contextmanager
def _service(home: Path | None) -> Iterator[UseCases]:
    """The use cases on the database, which is made where it is missing. Raises typer.Exit where it does not fit."""
    from alembic.util import CommandError

    from revisit.service.adapters.sqlite.migration import migrate
    from revisit.service.composition import offline_use_cases
    from revisit.service.settings import Settings

    # Files are for this user only.
    os.umask(0o077)
    settings = Settings(home=home) if home else Settings()
    try:
        migrate(settings.database)
    except CommandError as error:
        raise refuse(f"the database {settings.database} does not fit this version: {error}") from error
    with offline_use_cases(settings) as use_cases:
        yield use_cases


def _show_new(made: NewKey, as_json: bool) -> None:
    if as_json:
        emit_json({**_key_json(made.record), "key": made.text})
        return
    record = made.record
    say(made.text)
    typer.echo(
        f"Key {record.key_id} of tenant {record.tenant}, for {' and '.join(record.scopes)}. It is shown this once.",
        err=True,
    )


def _key_json(record: KeyRecord) -> dict[str, Any]:
    shown = asdict(record)
    del shown["secret_sha256"], shown["number"]
    return shown


def _noted(text: str) -> tuple[int, str]:
    number, _, digest = text.partition(":")
    if not number.isdecimal() or len(digest) != 64:
        raise refuse("--expect takes ROW:HASH, as `revisit audit verify` shows it")
    return int(number), digest


def _head(verdict: Any) -> str:
    return f"{verdict.rows}:{verdict.head}"


def _time(at_ns: int | None) -> str:
    return "" if at_ns is None else datetime.fromtimestamp(at_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _detail(row: AuditRecord) -> str:
    return ", ".join(f"{name} {value}" for name, value in row.detail.items())
