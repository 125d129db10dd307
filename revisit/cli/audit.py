"""`revisit audit`: the audit log, read from the database itself, whether or not the service runs."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.offline import use_cases_on
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, emit_table, refuse, say, utc

if TYPE_CHECKING:
    from revisit.service.ports.access import AuditRecord


@needs("service")
def audit(
    limit: Annotated[int, typer.Option(min=1, help="How many rows, counted from the newest.")] = 100,
    verify: Annotated[
        bool, typer.Option("--verify", help="Check that no row was changed or taken out; exit status 1 where one was.")
    ] = False,
    expect: Annotated[str, typer.Option(help="With --verify: ROW:HASH noted from an earlier run.")] = "",
    home: Home = None,
    json: Json = False,
) -> None:
    """Show the newest rows of the audit log, oldest first, or verify all of it."""
    if verify:
        _verify(expect, home, json)
    elif expect:
        raise refuse("--expect is for --verify")
    else:
        _list(limit, home, json)


def _list(limit: int, home: Path | None, as_json: bool) -> None:
    with use_cases_on(home) as use_cases:
        rows = asyncio.run(use_cases.audit.newest(limit))
    if as_json:
        emit_json([asdict(row) for row in rows])
        return
    table = [(r.number, utc(r.at_ns), r.tenant, r.actor, r.action, r.subject, _detail(r)) for r in rows]
    emit_table("Audit log", ("row", "time", "tenant", "actor", "action", "subject", "detail"), table)


def _verify(expect: str, home: Path | None, as_json: bool) -> None:
    with use_cases_on(home) as use_cases:
        verdict = asyncio.run(use_cases.audit.verify())
        if expect and verdict.fault is None and not asyncio.run(use_cases.audit.holds(*_noted(expect))):
            raise refuse(f"the log is not the one that {expect} was noted from")
    if as_json:
        emit_json(asdict(verdict))
    elif verdict.fault is None:
        head = f"{verdict.rows}:{verdict.head}"
        say(f"{verdict.rows} rows, each bound to the one before. Note the last one elsewhere: {head}")
    if verdict.fault is not None:
        raise refuse(f"the audit log was tampered with: {verdict.fault}")


def _noted(text: str) -> tuple[int, str]:
    """The number and the hash of a row, out of ROW:HASH."""
    number, _, digest = text.partition(":")
    if not number.isdecimal() or len(digest) != 64:
        raise refuse("--expect takes ROW:HASH, as `revisit audit --verify` shows it")
    return int(number), digest


def _detail(row: AuditRecord) -> str:
    return ", ".join(f"{name} {value}" for name, value in row.detail.items())
