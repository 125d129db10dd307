"""`revisit loop`: a person accepts or rejects a loop closure, or takes that back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, say
from revisit.cli.submap_names import short_name

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import LoopClosure

group = typer.Typer(help="Decide about a loop closure of a map.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(help="Its id, as `revisit loops` lists it, or the whole name.")]
Note = Annotated[str, typer.Option(help="Why; kept with the decision.")]


@group.command("accept")
def accept(name: Name, map_id: MapName = "default", note: Note = "", http: Http = HTTP, json: Json = False) -> None:
    """Accept a loop closure whatever its verdict was."""
    _decide(name, map_id, http, json, lambda client, loop: client.accept_loop_closure(loop, note=note))


@group.command("reject")
def reject(name: Name, map_id: MapName = "default", note: Note = "", http: Http = HTTP, json: Json = False) -> None:
    """Reject a loop closure, so that the map does not rest on it."""
    _decide(name, map_id, http, json, lambda client, loop: client.reject_loop_closure(loop, note=note))


@group.command("revert")
def revert(name: Name, map_id: MapName = "default", note: Note = "", http: Http = HTTP, json: Json = False) -> None:
    """Take back the last decision of a person on a loop closure."""
    _decide(name, map_id, http, json, lambda client, loop: client.revert_loop_closure(loop, note=note))


def _decide(name: str, map_id: str, http: str, as_json: bool, decision: Callable[[Client, str], LoopClosure]) -> None:
    from revisit.sdk.client import Client

    whole = name if "/" in name else f"maps/{map_id}/loopClosures/{name}"
    with Client(http) as client:
        decided = decision(client, whole)
    if as_json:
        emit_json(asdict(decided))
    else:
        say(f"{decided.name} is {decided.state}: {short_name(decided.query)} -> {short_name(decided.match)}")
