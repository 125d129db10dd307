"""`revisit query --explain`: why a submap has no loop with the places that look like it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from revisit.cli.output import emit_json, emit_table
from revisit.cli.submap_names import short_name

if TYPE_CHECKING:
    from revisit.sdk.client import Client


def emit_near_misses(client: Client, submap: str, k: int, as_json: bool) -> None:
    """The gate that stopped each near miss of a submap, and the value that would have passed it."""
    found = client.explain(submap, k=k)
    if as_json:
        emit_json([asdict(miss) | {"remedy": miss.remedy} for miss in found])
        return
    rows = [
        (short_name(miss.submap), miss.similarity, miss.gate, miss.measured, miss.threshold, miss.remedy)
        for miss in found
    ]
    columns = ("submap", "similarity", "gate", "measured", "threshold", "passes with")
    emit_table(f"Near misses of {short_name(submap)}", columns, rows)
