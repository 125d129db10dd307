"""`revisit explain`: why a submap has no loop with the places that look like it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table


def explain(
    submap: Annotated[str, typer.Argument(help="SESSION/SUBMAP.")],
    map_id: MapName = "default",
    k: Annotated[int, typer.Option(min=1, max=100, help="How many of the most similar submaps to look at.")] = 20,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Say which gate stopped each near miss of a submap, and what would have passed it."""
    from revisit.sdk.client import Client

    session, _, name = submap.partition("/")
    with Client(http) as client:
        found = client.explain(f"maps/{map_id}/sessions/{session}/submaps/{name}", k=k)
    if json:
        emit_json([asdict(miss) | {"remedy": miss.remedy} for miss in found])
        return
    rows = [
        (
            miss.submap.partition("/sessions/")[2].replace("/submaps/", "/"),
            miss.similarity,
            miss.gate,
            miss.measured,
            miss.threshold,
            miss.remedy,
        )
        for miss in found
    ]
    emit_table(
        f"Near misses of {submap}", ("submap", "similarity", "gate", "measured", "threshold", "passes with"), rows
    )
