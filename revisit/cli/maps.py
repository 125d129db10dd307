"""`revisit map`: one map out of many sessions: optimised, its versions, its files, its tiles."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli import map_changes, map_tiles, map_versions
from revisit.cli.former_names import WithFormerNames
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, refuse, say, utc
from revisit.cli.pose_graph import optimise_here
from revisit.cli.retention import retention
from revisit.cli.waiting import waited

if TYPE_CHECKING:
    from revisit.sdk.resources import MapVersion

group = typer.Typer(
    help="Make one map out of many sessions: optimise it, look at it, go back.",
    no_args_is_help=True,
    cls=WithFormerNames,
)
group.command("save")(map_versions.save)
group.command("tiles")(map_tiles.tiles)
group.command("changes")(map_changes.changes)
group.command("publish")(map_versions.publish)
group.command("check")(map_versions.check)
group.command("retention")(retention)


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
def optimise(
    map_id: MapName = "default",
    here: Annotated[
        bool, typer.Option("--here", help="On this machine, to look at; the map itself stays as it is.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="--here: folder for graph.g2o and one trajectory (TUM, in the map) a session.")
    ] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Have a worker optimise the pose graph of a map, which becomes its new version.

    With `--here`: shows the corrections of its sessions, and which loops they rest on or set aside.
    """
    from revisit.sdk.client import Client

    if here:
        optimise_here(map_id, out, http, json)
        return
    if out is not None:
        raise refuse("--out is for --here; `revisit export` writes a version in force")
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
    for fault in (fault for one in found if one.in_force for fault in one.summary.odometry_faults):
        say(f"{fault.session.rpartition('/')[2]}: {fault.message}.")
    for one in (join for version in found if version.in_force for join in version.summary.refused_joins):
        sides = (", ".join(name.rpartition("/")[2] for name in side) for side in (one.sessions, one.other_sessions))
        say(f"Kept apart by their surfaces: {' and '.join(sides)} ({one.reason}, {one.loops} loops).")
