"""`revisit loop`: a person accepts or rejects a loop closure, or takes that back."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, refuse, say
from revisit.cli.submap_names import short_name

DECISIONS = ("accept", "reject", "revert")

Name = Annotated[str, typer.Argument(help="Its id, as `revisit loops` lists it, or the whole name.")]
Note = Annotated[str, typer.Option(help="Why; kept with the decision.")]


def loop(
    decision: Annotated[str, typer.Argument(help="accept, reject, or revert: take the last decision back.")],
    name: Name,
    map_id: MapName = "default",
    note: Note = "",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Accept or reject a loop closure of any verdict, or take back the last decision of a person on it."""
    if decision not in DECISIONS:
        raise refuse(f"the decision is one of {', '.join(DECISIONS)}")
    from revisit.sdk.client import Client

    whole = name if "/" in name else f"maps/{map_id}/loopClosures/{name}"
    with Client(http) as client:
        decide = {
            "accept": client.accept_loop_closure,
            "reject": client.reject_loop_closure,
            "revert": client.revert_loop_closure,
        }
        decided = decide[decision](whole, note=note)
    if json:
        emit_json(asdict(decided))
    else:
        say(f"{decided.name} is {decided.state}: {short_name(decided.query)} -> {short_name(decided.match)}")
