"""`revisit keys` and `revisit audit`: commands and their options; the work is in `guarding`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

keys = typer.Typer(help="Make, list, rotate and revoke API keys, in the database itself.", no_args_is_help=True)
audit = typer.Typer(help="Read and verify the audit log.", no_args_is_help=True)

Home = Annotated[Path | None, typer.Option(help="Directory of the database and the blobs.")]
Json = Annotated[bool, typer.Option("--json", help="Answer as JSON.")]
KeyId = Annotated[str, typer.Argument(help="The part of the key between the underscores.")]


@keys.command("create")
def keys_create(
    scope: Annotated[list[str] | None, typer.Option(help="ingest, query or admin; may be repeated.")] = None,
    tenant: Annotated[str, typer.Option(help="Whose maps the key opens.")] = "default",
    label: Annotated[str, typer.Option(help="What the key is for.")] = "",
    expires_days: Annotated[float | None, typer.Option(min=0.0, help="Days it lives; for ever by default.")] = None,
    home: Home = None,
    json: Json = False,
) -> None:
    """Make a key (for ingest and query by default) and show it, once. The first one ends the time without keys."""
    from revisit.cli import guarding
    from revisit.service.application.access.api_keys import CreateKey

    lifetime_s = None if expires_days is None else expires_days * guarding.DAY_S
    guarding.create(home, CreateKey(tenant, tuple(scope or ("ingest", "query")), label, lifetime_s), json)


@keys.command("list")
def keys_list(home: Home = None, json: Json = False) -> None:
    """Show every key ever made, without its secret."""
    from revisit.cli import guarding

    guarding.list_keys(home, json)


@keys.command("rotate")
def keys_rotate(
    key_id: KeyId,
    grace_hours: Annotated[float, typer.Option(min=0.0, help="How long the old key goes on.")] = 24.0,
    home: Home = None,
    json: Json = False,
) -> None:
    """Make a successor with the same rights and show it, once; the old key goes on for a while."""
    from revisit.cli import guarding

    guarding.rotate(home, key_id, grace_hours, json)


@keys.command("revoke")
def keys_revoke(key_id: KeyId, home: Home = None, json: Json = False) -> None:
    """End a key at once; open streams end within 30 s."""
    from revisit.cli import guarding

    guarding.revoke(home, key_id, json)


@audit.command("list")
def audit_list(
    limit: Annotated[int, typer.Option(min=1, help="How many rows, counted from the newest.")] = 100,
    home: Home = None,
    json: Json = False,
) -> None:
    """Show the newest rows, oldest first."""
    from revisit.cli import guarding

    guarding.list_audit(home, limit, json)


@audit.command("verify")
def audit_verify(
    expect: Annotated[str, typer.Option(help="ROW:HASH noted from an earlier run.")] = "",
    home: Home = None,
    json: Json = False,
) -> None:
    """Check that no row was changed or taken out; exit status 1 where one was."""
    from revisit.cli import guarding

    guarding.verify_audit(home, expect, json)
