"""`revisit explain`: why a submap has no loop with the places that look like it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table
from revisit.cli.submap_names import full_name, short_name


def explain(
    submap: Annotated[str, typer.Argument(help="SESSION/SUBMAP, or the whole name.")],
    map_id: MapName = "default",
    k: Annotated[int, typer.Option(min=1, max=100, help="How many of the most similar submaps to look at.")] = 20,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Say which gate stopped each near miss of a submap, and the value that would have passed it."""
    from revisit.sdk.client import Client

    name = full_name(map_id, submap)
    with Client(http) as client:
        found = client.explain(name, k=k)
    if json:
        emit_json([asdict(miss) | {"remedy": miss.remedy} for miss in found])
        return
    rows = [
        (short_name(miss.submap), miss.similarity, miss.gate, miss.measured, miss.threshold, miss.remedy)
        for miss in found
    ]
    columns = ("submap", "similarity", "gate", "measured", "threshold", "passes with")
    emit_table(f"Near misses of {short_name(name)}", columns, rows)
