"""`revisit export`: submap poses and accepted loops in files that other tools read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
    """Write submap poses and accepted loops as a pose graph (g2o), a trajectory (tum) or a table of loops (csv)."""
    from revisit.cli.pose_graph_files import as_csv, as_g2o, as_tum

    writers: dict[str, Callable[[Graph], str]] = {"g2o": as_g2o, "tum": as_tum, "csv": as_csv}
    if file_format not in writers:
        raise refuse("--format is g2o, tum or csv")
    if file_format == "tum" and not session_id:
        raise refuse("a tum file holds one trajectory: give --session")
    graph = _read(http, map_id, session_id)
    text = writers[file_format](graph)
    if out is None:
        say(text.rstrip("\n"))
        return
    out.write_text(text)
    summary = {"file": str(out), "submaps": sum(map(len, graph.tracks)), "loops": len(graph.loops)}
    if json:
        emit_json(summary)
    else:
        say(f"{out}: {summary['submaps']} submaps, {summary['loops']} loops")


def _read(http: str, map_id: str, session_id: str) -> Graph:
    """The submaps and accepted loops of a map, or of one session of it."""
    from revisit.cli.pose_graph_files import Graph
    from revisit.sdk.client import Client

    map_name = f"maps/{map_id}"
    with Client(http) as client:
        if session_id:
            names = [f"{map_name}/sessions/{session_id}"]
        else:
            names = [session.name for session in client.list_sessions(map_name)]
        tracks = [client.list_submaps(name) for name in names]
        loops = client.loop_closures(map_name, state="ACCEPTED")
    chosen = {submap.name for track in tracks for submap in track}
    return Graph(tracks, [loop for loop in loops if {loop.query, loop.match} <= chosen])
