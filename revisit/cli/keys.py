"""`revisit keys`: API keys, in the database itself, whether or not the service runs."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import needs
from revisit.cli.offline import use_cases_on
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, emit_table, say, utc

if TYPE_CHECKING:
    from revisit.service.features.keys.calls import NewKey
    from revisit.service.ports.access import KeyRecord

DAY_S = 86400.0
HOUR_S = 3600.0

KeyId = Annotated[str, typer.Argument(help="The part of the key between the underscores.")]

group = typer.Typer(help="Make, list, rotate and revoke API keys, in the database itself.", no_args_is_help=True)


@group.command("create")
@needs("service")
def create_key(
    scope: Annotated[list[str] | None, typer.Option(help="ingest, query or admin; may be repeated.")] = None,
    tenant: Annotated[str, typer.Option(help="Whose maps the key opens.")] = "default",
    label: Annotated[str, typer.Option(help="What the key is for.")] = "",
    expires_days: Annotated[float | None, typer.Option(min=0.0, help="Days it lives; for ever by default.")] = None,
    home: Home = None,
    json: Json = False,
) -> None:
    """Make a key (for ingest and query by default) and show it, once. The first one ends the time without keys."""
    from revisit.service.features.keys.calls import CreateKey

    lifetime_s = None if expires_days is None else expires_days * DAY_S
    wanted = CreateKey(tenant, tuple(scope or ("ingest", "query")), label, lifetime_s)
    with use_cases_on(home) as use_cases:
        _show_new(asyncio.run(use_cases.keys.create(wanted)), json)


@group.command("list")
@needs("service")
def list_keys(home: Home = None, json: Json = False) -> None:
    """Show every key ever made, without its secret."""
    with use_cases_on(home) as use_cases:
        keys = asyncio.run(use_cases.keys.all())
    if json:
        emit_json([_key_json(key) for key in keys])
        return
    rows = [
        (k.key_id, k.tenant, " ".join(k.scopes), k.label, utc(k.created_at_ns), utc(k.expires_at_ns),
         utc(k.revoked_at_ns))
        for k in keys
    ]  # fmt: skip
    emit_table("Keys", ("id", "tenant", "scopes", "label", "created", "expires", "revoked"), rows)


@group.command("rotate")
@needs("service")
def rotate_key(
    key_id: KeyId,
    grace_hours: Annotated[float, typer.Option(min=0.0, help="How long the old key goes on.")] = 24.0,
    home: Home = None,
    json: Json = False,
) -> None:
    """Make a successor with the same rights and show it, once; the old key goes on for a while."""
    with use_cases_on(home) as use_cases:
        _show_new(asyncio.run(use_cases.keys.rotate(key_id, grace_hours * HOUR_S)), json)


@group.command("revoke")
@needs("service")
def revoke_key(key_id: KeyId, home: Home = None, json: Json = False) -> None:
    """End a key at once; open streams end within 3 s."""
    with use_cases_on(home) as use_cases:
        record = asyncio.run(use_cases.keys.revoke(key_id))
    if json:
        emit_json(_key_json(record))
    else:
        say(f"Key {key_id} opens nothing any more; open streams end within 3 s.")


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
