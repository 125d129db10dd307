"""`revisit export`: submap poses and accepted loops in files that other tools read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import what_is_missing
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, refuse, say

if TYPE_CHECKING:
    from revisit.cli.pose_graph_files import Graph


def export(
    map_id: MapName = "default",
    file_format: Annotated[str, typer.Option("--format", help="g2o, tum or csv.")] = "g2o",
    session_id: Annotated[str, typer.Option("--session", help="Only this session; tum needs one.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; stdout by default.")] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Write a map as an optimised pose graph (g2o), a session as a trajectory (tum), or a table of loops (csv)."""
    from revisit.cli.pose_graph_files import as_csv, as_g2o, as_tum, read_graph

    writers: dict[str, Callable[[Graph], str]] = {"g2o": as_g2o, "tum": as_tum, "csv": as_csv}
    if file_format not in writers:
        raise refuse("--format is g2o, tum or csv")
    if file_format == "tum" and not session_id:
        raise refuse("a tum file holds one trajectory: give --session")
    graph = read_graph(http, map_id, session_id)
    try:
        text = writers[file_format](graph)
    except ModuleNotFoundError as error:
        raise refuse(what_is_missing("service", error)) from error
    if out is None:
        say(text.rstrip("\n"))
        return
    out.write_text(text)
    summary = {"file": str(out), "submaps": sum(map(len, graph.tracks)), "loops": len(graph.loops)}
    if json:
        emit_json(summary)
    else:
        say(f"{out}: {summary['submaps']} submaps, {summary['loops']} loops")
