"""`revisit map`: one map out of many sessions: optimised, its versions, its files, its tiles."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli import map_tiles, map_versions
from revisit.cli.merging import show_changes
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, refuse, say, utc
from revisit.cli.waiting import waited

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import MapChange, MapMerge, MapVersion

group = typer.Typer(help="Make one map out of many sessions: optimise it, look at it, go back.", no_args_is_help=True)
group.command("save")(map_versions.save)
group.command("tiles")(map_tiles.tiles)
group.command("distance")(map_tiles.distance)
group.command("publish")(map_versions.publish)
group.command("check")(map_versions.check)


@group.command("create")
def create(
    map_id: Annotated[str, typer.Argument(metavar="MAP", help="Id of the new map.")],
    display_name: Annotated[str, typer.Option("--name", help="Name for people.")] = "",
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of its scene compared with a street.")
    ] = None,
    profile: Annotated[
        str | None, typer.Option(help="product, or paper: the method as it is written; workers need torch.")
    ] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Create a map; `revisit ingest` creates one that is missing, with nothing of its own."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        made = client.create_map(map_id, display_name=display_name, scene_scale=scene_scale, profile=profile)
    if json:
        emit_json(asdict(made))
    else:
        say(f"{made.name} is in the profile {made.profile}, its scene of scale {made.scene_scale:g}.")


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
    _emit_version(version, json)


@group.command("versions")
def versions(
    map_id: MapName = "default",
    revert: Annotated[
        int | None, typer.Option(help="Bring back the poses of this version, bit for bit, as a new version.")
    ] = None,
    files: Annotated[bool, typer.Option("--files", help="The published files of the versions instead.")] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the versions of a map, and the loops that each rests on; or bring the poses of one back."""
    from revisit.sdk.client import Client

    if files and revert is not None:
        raise refuse("give either --files or --revert")
    with Client(http) as client:
        if files:
            map_versions.emit_files(map_id, client.map_files(f"maps/{map_id}"), json)
        elif revert is not None:
            _emit_version(client.revert_map(f"maps/{map_id}", revert), json)
        elif json:
            emit_json([asdict(version) for version in client.map_versions(f"maps/{map_id}")])
        else:
            _show(client.map_versions(f"maps/{map_id}"))


@group.command("merges")
def merges(
    map_id: MapName = "default",
    changes: Annotated[
        bool, typer.Option("--changes", help="What vanished and what appeared, by the last merge that holds.")
    ] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Take the last merge back: its copies go, the poses from before return.")
    ] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the merges into a map, or the changes between its days by the last one; or take that one back."""
    from revisit.sdk.client import Client

    if changes and undo:
        raise refuse("give either --changes or --undo")
    with Client(http) as client:
        if changes:
            merge = _last_merge(client, map_id, "; sessions of one map are not compared")
            _emit_changes(list(merge.changes), json)
        elif undo:
            _emit_undone(client.revert_merge(_last_merge(client, map_id)), json)
        elif json:
            emit_json([asdict(merge) for merge in client.map_merges(f"maps/{map_id}")])
        else:
            _show_merges(client.map_merges(f"maps/{map_id}"))


def _last_merge(client: Client, map_id: str, hint: str = "") -> MapMerge:
    """The last merge into a map that was not taken back. Exits where there is none, and gives the hint."""
    held = [merge for merge in client.map_merges(f"maps/{map_id}") if merge.reverted_at_ns is None]
    if not held:
        raise refuse(f"no merge into map {map_id} is in force{hint}")
    return held[-1]


def _emit_changes(found: list[MapChange], as_json: bool) -> None:
    if as_json:
        emit_json([asdict(change) for change in found])
    else:
        show_changes(found)


def _emit_undone(merge: MapMerge, as_json: bool) -> None:
    if as_json:
        emit_json(asdict(merge))
    else:
        _show_merges([merge])


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


def _emit_version(version: MapVersion, as_json: bool) -> None:
    if as_json:
        emit_json(asdict(version))
    else:
        _show([version])


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
    for one in (join for version in found if version.in_force for join in version.summary.refused_joins):
        sides = (", ".join(name.rpartition("/")[2] for name in side) for side in (one.sessions, one.other_sessions))
        say(f"Kept apart by their surfaces: {' and '.join(sides)} ({one.reason}, {one.loops} loops).")
