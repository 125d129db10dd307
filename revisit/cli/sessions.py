"""`revisit session`: the sessions of a map, listed and deleted."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName, Yes
from revisit.cli.output import confirm, emit_json, emit_table, say

group = typer.Typer(help="List and delete the sessions of a map.", no_args_is_help=True)


@group.command("list")
def list_sessions(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """List the sessions of a map, oldest first."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.list_sessions(map_id)
    if json:
        emit_json([asdict(session) for session in found])
        return
    rows = [
        (one.name.rpartition("/")[2], one.state, one.committed_seq, one.submap_count, f"{one.travelled_m:.1f}")
        for one in found
    ]
    emit_table(f"Sessions of {map_id}", ("session", "state", "scans", "submaps", "travelled m"), rows)


@group.command("delete")
def delete(
    session_id: Annotated[str, typer.Argument(help="Id of the session.")],
    map_id: MapName = "default",
    yes: Yes = False,
    http: Http = HTTP,
) -> None:
    """Delete a session with its scans, submaps and loop closures. It cannot be brought back."""
    from revisit.sdk.client import Client

    name = f"maps/{map_id}/sessions/{session_id}"
    with Client(http) as client:
        found = client.get_session(name)
        confirm(f"Delete {name} with {found.submap_count} submaps?", yes)
        client.delete(name)
    say(f"{name} is deleted.")
