"""`revisit audit`: what happened, read from the database itself, whether or not the service runs."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.offline import use_cases_on
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, emit_table, refuse, say, utc

if TYPE_CHECKING:
    from revisit.service.application.contract.access_ports import AuditRecord

group = typer.Typer(help="Read and verify the audit log.", no_args_is_help=True)


@group.command("list")
@needs("service")
def list_audit(
    limit: Annotated[int, typer.Option(min=1, help="How many rows, counted from the newest.")] = 100,
    home: Home = None,
    json: Json = False,
) -> None:
    """Show the newest rows, oldest first."""
    with use_cases_on(home) as use_cases:
        rows = asyncio.run(use_cases.audit.newest(limit))
    if json:
        emit_json([asdict(row) for row in rows])
        return
    table = [(r.number, utc(r.at_ns), r.tenant, r.actor, r.action, r.subject, _detail(r)) for r in rows]
    emit_table("Audit log", ("row", "time", "tenant", "actor", "action", "subject", "detail"), table)


@group.command("verify")
@needs("service")
def verify_audit(
    expect: Annotated[str, typer.Option(help="ROW:HASH noted from an earlier run.")] = "",
    home: Home = None,
    json: Json = False,
) -> None:
    """Check that no row was changed or taken out; exit status 1 where one was."""
    with use_cases_on(home) as use_cases:
        verdict = asyncio.run(use_cases.audit.verify())
        if expect and verdict.fault is None and not asyncio.run(use_cases.audit.holds(*_noted(expect))):
            raise refuse(f"the log is not the one that {expect} was noted from")
    if json:
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
        raise refuse("--expect takes ROW:HASH, as `revisit audit verify` shows it")
    return int(number), digest


def _detail(row: AuditRecord) -> str:
    return ", ".join(f"{name} {value}" for name, value in row.detail.items())
