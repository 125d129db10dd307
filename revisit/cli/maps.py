"""`revisit map`: one map out of many sessions - how it stands, its versions, and what moves it."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli import map_tiles, map_versions
from revisit.cli.merging import show_changes
from revisit.cli.options import HTTP, Http, Json, MapName, Yes
from revisit.cli.output import confirm, emit_json, emit_table, refuse, say, utc
from revisit.cli.waiting import waited

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Correction, LoopClosure, MapMerge, MapVersion

group = typer.Typer(help="Make one map out of many sessions: optimise it, look at it, go back.", no_args_is_help=True)
group.command("save")(map_versions.save)
group.command("tiles")(map_tiles.tiles)
group.command("tile")(map_tiles.tile)
group.command("distance")(map_tiles.distance)
group.command("publish")(map_versions.publish)
group.command("files")(map_versions.files)
group.command("check")(map_versions.check)
group.command("diff")(map_versions.diff)
group.command("localise")(map_versions.localise)


@group.command("list")
def list_maps(http: Http = HTTP, json: Json = False) -> None:
    """List the maps, oldest first."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.list_maps()
    if json:
        emit_json([asdict(one) for one in found])
        return
    rows = [
        (
            one.name.rpartition("/")[2],
            one.display_name,
            one.session_count,
            one.submap_count,
            one.map_version or "-",
            one.scene_scale,
        )
        for one in found
    ]
    emit_table("Maps", ("map", "name", "sessions", "submaps", "version", "scene scale"), rows)


@group.command("delete")
def delete(map_id: Annotated[str, typer.Argument(help="Id of the map.")], yes: Yes = False, http: Http = HTTP) -> None:
    """Delete a map with all of its sessions. It cannot be brought back."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.get_map(map_id)
        confirm(f"Delete {found.name} with {found.session_count} sessions, {found.submap_count} submaps?", yes)
        client.delete(f"maps/{map_id}")
    say(f"maps/{map_id} is deleted.")


@group.command("status")
def status(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """Where the sessions of a map lie to each other, and which loops that rests on."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.get_map(f"maps/{map_id}")
        corrections = _corrections(client, found.name)
        loops = client.loop_closures(found.name, state="ALL")
    if json:
        emit_json(
            {
                "map_version": found.map_version,
                "sessions": {name: None if one is None else asdict(one) for name, one in corrections.items()},
                "loops": dict(_counted(loops)),
            }
        )
        return
    title = f"Map {map_id}, version {found.map_version or '-'}"
    columns = ("session", "frame", "x m", "y m", "z m", "yaw deg", "sigma m")
    emit_table(title, columns, [_row(session, correction) for session, correction in corrections.items()])
    say(f"Loops: {', '.join(f'{count} {words}' for words, count in _counted(loops).items()) or 'none'}.")


@group.command("optimise")
def optimise(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """Have a worker optimise the pose graph of a map, which becomes its new version.

    `revisit pose-graph` does it on this machine and changes nothing.
    """
    from revisit.sdk.client import Client

    with Client(http) as client:
        done = waited(client, client.optimise_map(f"maps/{map_id}"), quiet=json)
        result = done.result or {}
        if "version" not in result:
            raise refuse(f"map {map_id} has no new version: {result.get('outcome', done.state)}")
        version = client.get_map_version(result["version"])
    if json:
        emit_json(asdict(version))
    else:
        _show([version])


@group.command("versions")
def versions(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """List the versions of a map that are kept, and what each rests on."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.map_versions(f"maps/{map_id}")
    if json:
        emit_json([asdict(version) for version in found])
    else:
        _show(found)


@group.command("revert")
def revert(
    version: Annotated[int, typer.Argument(help="The version whose poses come back.")],
    map_id: MapName = "default",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Bring back the poses of an earlier version, bit for bit, as a new version."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        restored = client.revert_map(f"maps/{map_id}", version)
    if json:
        emit_json(asdict(restored))
    else:
        _show([restored])


@group.command("merges")
def merges(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """List what was merged into a map."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.map_merges(f"maps/{map_id}")
    if json:
        emit_json([asdict(merge) for merge in found])
    else:
        _show_merges(found)


@group.command("changes")
def changes(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """List what vanished and what appeared between the days of a map, by its last merge that holds."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        held = _held_merges(client, map_id)
    if not held:
        raise refuse(f"nothing was merged into map {map_id}")
    if json:
        emit_json([asdict(change) for change in held[-1].changes])
    else:
        show_changes(list(held[-1].changes))


@group.command("unmerge")
def unmerge(map_id: MapName = "default", http: Http = HTTP, json: Json = False) -> None:
    """Take the last merge into a map back: its copies are deleted, the poses from before it come back."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        held = _held_merges(client, map_id)
        if not held:
            raise refuse(f"nothing was merged into map {map_id}")
        reverted = client.revert_merge(held[-1])
    if json:
        emit_json(asdict(reverted))
    else:
        _show_merges([reverted])


def _held_merges(client: Client, map_id: str) -> list[MapMerge]:
    """The merges into a map that were not taken back, in their order."""
    return [merge for merge in client.map_merges(f"maps/{map_id}") if merge.reverted_at_ns is None]


def _show_merges(found: list[MapMerge]) -> None:
    rows = [
        (
            one.name.rpartition("/")[2],
            one.source,
            utc(one.created_at_ns),
            one.version,
            len(one.sessions),
            len(one.changes),
            "" if one.reverted_at_ns is None else utc(one.reverted_at_ns),
        )
        for one in found
    ]
    emit_table("Merges", ("merge", "of", "made", "version", "sessions", "changes", "taken back"), rows)


def _corrections(client: Client, map_name: str) -> dict[str, Correction | None]:
    """The correction of each session by its id, None where the map has no frame for it yet."""
    from revisit.sdk.errors import FailedPrecondition

    found: dict[str, Correction | None] = {}
    for session in client.list_sessions(map_name):
        try:
            found[session.name.rpartition("/")[2]] = client.correction(session)
        except FailedPrecondition:
            found[session.name.rpartition("/")[2]] = None
    return found


def _row(session: str, correction: Correction | None) -> tuple[Any, ...]:
    if correction is None:
        return (session, "not in the map yet")
    T_map_odom = correction.T_map_odom
    yaw_deg = math.degrees(math.atan2(T_map_odom[1, 0], T_map_odom[0, 0]))
    sigma_m = math.sqrt(max(float(correction.covariance[:3, :3].trace()), 0.0))
    x, y, z = (f"{value:.2f}" for value in T_map_odom[:3, 3])
    return session, correction.frame, x, y, z, f"{yaw_deg:.1f}", f"{sigma_m:.2f}"


def _counted(loops: list[LoopClosure]) -> Counter[str]:
    """How many loops there are of each verdict: that of the pose graph where it has one, else that of geometry."""
    words = {"IN_MAP": "in the map", "SET_ASIDE": "set aside", "UNCONNECTED": "of sessions that share no frame"}
    others = {"ACCEPTED": "not asked yet", "REJECTED": "rejected", "PROPOSED": "proposed"}
    return Counter(words.get(loop.graph_state or "", others.get(loop.state, loop.state)) for loop in loops)


def _show(found: list[MapVersion]) -> None:
    rows = [
        (
            f"{one.version}{' *' if one.in_force else ''}",
            utc(one.created_at_ns),
            f"version {one.restored_from}" if one.restored_from else "",
            one.summary.sessions,
            one.summary.frames,
            one.summary.submaps,
            one.summary.loops_in_map,
            one.summary.loops_set_aside,
            f"{one.summary.chi2:.0f} / {one.summary.degrees_of_freedom}",
            "" if one.summary.max_change_m is None else f"{one.summary.max_change_m:.2f}",
        )
        for one in found
    ]
    columns = ("version", "made", "brought back", "sessions", "frames", "submaps", "loops", "set aside", "chi2 / dof")
    emit_table("Versions, * is in force", (*columns, "moved at most m"), rows)
