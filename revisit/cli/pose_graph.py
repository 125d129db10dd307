"""`revisit map optimise --here`: where the sessions of a map lie to each other, and which loops that rests on."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from revisit.cli.extras import needs
from revisit.cli.output import emit_json, emit_table, refuse, say, signs

if TYPE_CHECKING:
    from revisit.cli.pose_graph_files import Graph
    from revisit.core.pose_graph.graph import PoseGraph
    from revisit.core.pose_graph.optimisation import OptimisedGraph


@needs("service")
def optimise_here(map_id: str, out: Path | None, http: str, json: bool) -> None:
    """Optimise the pose graph of a map on this machine; write it and the trajectories to the folder `out`."""
    from revisit.cli import pose_graph_files
    from revisit.core.pose_graph.optimisation import optimise

    signs.doing("optimising here; the first time it compiles its kernels, for some 20 s")
    read = pose_graph_files.read_graph(http, map_id)
    graph = pose_graph_files.pose_graph(read)
    if not graph.trajectories:
        raise refuse(f"map {map_id} holds no submaps")
    optimised = optimise(graph)
    if out is not None:
        _write(out, read, graph, optimised)
    if json:
        emit_json(_summary(graph, optimised))
    else:
        _show(graph, optimised)


def _write(out: Path, read: Graph, graph: PoseGraph, optimised: OptimisedGraph) -> None:
    from revisit.cli.pose_graph_files import optimised_g2o, tum_lines
    from revisit.formats.whole_files import write_whole

    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / "graph.g2o", optimised_g2o(graph, optimised))
    for track in read.tracks:
        if track:
            session = track[0].name.partition("/submaps/")[0]
            poses = zip(track, optimised.T_map_submap[session], strict=True)
            write_whole(out / f"{session.rpartition('/')[2]}.tum", tum_lines(poses))


def _summary(graph: PoseGraph, optimised: OptimisedGraph) -> dict[str, Any]:
    from revisit.sdk.messages import pose_json

    sessions = [
        {
            "session": one.session,
            "frame": _frame(one.session, optimised),
            "T_map_odom": pose_json(optimised.T_map_odom(one)),
        }
        for one in graph.trajectories
    ]
    loops = [
        {"name": loop.name, "state": state.value, "squared_distance": None if math.isnan(residual) else float(residual)}
        for loop, state, residual in zip(graph.loops, optimised.loops, optimised.residuals, strict=True)
    ]
    return {"sessions": sessions, "loops": loops}


def _show(graph: PoseGraph, optimised: OptimisedGraph) -> None:
    rows = []
    for one in graph.trajectories:
        T_map_odom = optimised.T_map_odom(one)
        yaw_deg = math.degrees(math.atan2(T_map_odom[1, 0], T_map_odom[0, 0]))
        x, y, z = (f"{value:.2f}" for value in T_map_odom[:3, 3])
        frame = _frame(one.session, optimised).rpartition("/")[2]
        rows.append((one.session.rpartition("/")[2], len(one), frame, x, y, z, f"{yaw_deg:.1f}"))
    emit_table("Sessions", ("session", "submaps", "in the frame of", "x m", "y m", "z m", "yaw deg"), rows)
    counts = Counter(state.value for state in optimised.loops)
    say(
        f"Loops: {counts['IN_MAP']} in the map, {counts['SET_ASIDE']} set aside, {counts['UNCONNECTED']} of sessions "
        "that share no frame."
    )


def _frame(session: str, optimised: OptimisedGraph) -> str:
    """The session of the map's frame for this one."""
    return next(group[0] for group in optimised.components if session in group)
