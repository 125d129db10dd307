"""query and loops: questions to a running service."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from revisit.cli.output import emit_json, emit_table, refuse, say
from revisit.formats import media_type_for_suffix
from revisit.sdk.client import Client
from revisit.sdk.clouds import Cloud


def query(http: str, map_id: str, cloud: Path | None, submap: str, k: int, as_json: bool) -> None:
    """Localise a cloud file, or search by a submap."""
    if (cloud is None) == (not submap):
        raise refuse("give either a cloud file or --submap SESSION/SUBMAP")
    with Client(http) as client:
        if cloud is not None:
            _localize(client, map_id, cloud, k, as_json)
        else:
            _search(client, map_id, submap, k, as_json)


def loops(http: str, map_id: str, state: str, session_id: str, as_json: bool) -> None:
    """List the loop closures of a map."""
    if state not in ("ACCEPTED", "REJECTED", "ALL"):
        raise refuse("--state is ACCEPTED, REJECTED or ALL")
    with Client(http) as client:
        session = f"maps/{map_id}/sessions/{session_id}" if session_id else None
        found = client.loop_closures(f"maps/{map_id}", state=None if state == "ALL" else state, session=session)
    if as_json:
        emit_json([asdict(loop) for loop in found])
        return
    rows = [
        (_short(loop.query), _short(loop.match), loop.state, loop.reason, loop.similarity, loop.score) for loop in found
    ]
    emit_table(
        f"{len(found)} loop closure{'' if len(found) == 1 else 's'}",
        ("query", "match", "verdict", "reason", "similarity", "score"),
        rows,
    )


def _localize(client: Client, map_id: str, cloud: Path, k: int, as_json: bool) -> None:
    encoded = Cloud(cloud.read_bytes(), media_type_for_suffix(cloud.suffix))
    found = client.localize(f"maps/{map_id}", encoded, candidates=k)
    if as_json:
        emit_json(asdict(found))
        return
    rows = [(_short(c.submap), c.accepted, c.reason, c.similarity, c.score) for c in found.candidates]
    emit_table("Compared", ("submap", "accepted", "reason", "similarity", "score"), rows)
    if found.best is None or found.T_odom_query is None:
        say("This place is not in the map.")
        return
    x, y, z = found.T_odom_query[:3, 3]
    say(f"Taken at x {x:.2f} m, y {y:.2f} m, z {z:.2f} m in the odometry frame of {_short(found.session or '')}.")


def _search(client: Client, map_id: str, submap: str, k: int, as_json: bool) -> None:
    session_id, _, submap_id = submap.partition("/")
    hits = client.search(f"maps/{map_id}", submap=f"maps/{map_id}/sessions/{session_id}/submaps/{submap_id}", k=k)
    if as_json:
        emit_json([asdict(hit) for hit in hits])
        return
    emit_table("Most similar", ("submap", "similarity"), [(_short(hit.submap), hit.similarity) for hit in hits])


def _short(name: str) -> str:
    parts = name.split("/")
    return "/".join(parts[3::2])
