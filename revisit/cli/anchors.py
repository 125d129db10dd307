"""`revisit anchors`: places that the world outside knows, which put a map on earth, and tags that robots saw."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.options import HTTP, Http, Json, MapName, Yes
from revisit.cli.output import confirm, counted, emit_json, emit_table, refuse, say
from revisit.cli.submap_names import session_name
from revisit.cli.waiting import waited

if TYPE_CHECKING:
    from revisit.sdk.resources import Anchor

group = typer.Typer(
    help="Put a map on earth: places that the world outside knows; and tags that robots saw.", no_args_is_help=True
)

SessionName = Annotated[str, typer.Option("--session", help="Id of the session that they belong to.")]
File = Annotated[
    Path, typer.Argument(exists=True, dir_okay=False, help="A table (CSV) with a heading, or JSON as the API has it.")
]


@group.command("add")
def add(
    file: File, session_id: SessionName, map_id: MapName = "default", http: Http = HTTP, json: Json = False
) -> None:
    """Post the anchors of a file; those that the session has with the same content are passed over."""
    from revisit.cli.anchor_files import anchors_in
    from revisit.sdk.client import Client

    anchors = anchors_in(file)
    with Client(http) as client:
        posted = client.sessions.post_anchors(session_name(map_id, session_id), anchors)
    if json:
        emit_json([asdict(one) for one in posted])
    else:
        say(f"{session_name(map_id, session_id)} has {counted(len(posted), 'anchor')} of {file.name}.")


@group.command("preview")
def preview(
    file: File, session_id: SessionName, map_id: MapName = "default", http: Http = HTTP, json: Json = False
) -> None:
    """Show the effect that the anchors of a file, at most 200, would have on the map; nothing is kept."""
    from revisit.cli.anchor_files import anchors_in
    from revisit.sdk.anchors import ANCHORS_AT_ONCE
    from revisit.sdk.client import Client

    anchors = anchors_in(file)
    if len(anchors) > ANCHORS_AT_ONCE:
        raise refuse(f"{file.name} holds {len(anchors)} anchors: at most {ANCHORS_AT_ONCE} are tried at once")
    with Client(http) as client:
        asked = client.sessions.preview_anchors(session_name(map_id, session_id), anchors)
        told = waited(client, asked, quiet=json).result or {}
    if json:
        emit_json(told)
        return
    if "anchors" not in told:
        raise refuse(f"map {map_id} cannot be tried: {told.get('outcome', 'it has no submaps')}")
    emit_table("Would be", COLUMNS, [_row(one) for one in told["anchors"]])
    if told.get("others"):
        emit_table("Others that would change", COLUMNS, [_row(one) for one in told["others"]])
    for frame in told.get("georeferences", ()):
        _say_sessions(frame.get("sessions", ()))
    if "max_change_m" in told:
        say(f"Submaps would move by {told['mean_change_m']:.2f} m on average, {told['max_change_m']:.2f} m at most.")


@group.command("list")
def list_anchors(
    session_id: Annotated[str, typer.Option("--session", help="Only those of this session.")] = "",
    map_id: MapName = "default",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the anchors of a map, or of one session, with the verdict of the version in force."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        sessions = [session_name(map_id, session_id)] if session_id else client.sessions.list(f"maps/{map_id}")
        found: list[Anchor] = [one for session in sessions for one in client.sessions.anchors(session)]
        versions = [] if json else [one for one in client.versions.list(f"maps/{map_id}") if one.in_force]
    if json:
        emit_json([asdict(one) for one in found])
        return
    holding = sum(one.state == "IN_MAP" for one in found)
    emit_table(
        f"{holding} of {counted(len(found), 'anchor')} {'agree' if any(one.tag for one in found) else 'hold the map'}",
        ("kind", *COLUMNS),
        [_listed(one) for one in found],
    )
    names = {one if isinstance(one, str) else one.name for one in sessions}
    for frame in (frame for one in versions for frame in one.summary.georeferences):
        _say_sessions([vars(one) for one in frame.sessions if one.session in names])


@group.command("remove")
def remove(
    anchor_ids: Annotated[list[str] | None, typer.Argument(metavar="ID...", help="Those to remove.")] = None,
    session_id: SessionName = "",
    every: Annotated[bool, typer.Option("--all", help="All of the session.")] = False,
    map_id: MapName = "default",
    yes: Yes = False,
    http: Http = HTTP,
) -> None:
    """Remove anchors of a session; the map is optimised without them."""
    from revisit.sdk.client import Client

    if not session_id or every == bool(anchor_ids):
        raise refuse("give --session and either ID... or --all")
    session = session_name(map_id, session_id)
    with Client(http) as client:
        names = [one.name for one in client.sessions.anchors(session)] if every else _names(session, anchor_ids or [])
        confirm(f"Remove {counted(len(names), 'anchor')} of {session}?", yes)
        for name in names:
            client.sessions.delete_anchor(name)
    say(f"{session} has lost {counted(len(names), 'anchor')}.")


def _say_sessions(sessions: Iterable[Mapping[str, Any]]) -> None:
    """Name the sessions whose anchors are not as they state."""
    for one in sessions:
        say(anchors_of_session(one))


def anchors_of_session(one: Mapping[str, Any]) -> str:
    """The fields of an AnchoredSession in words."""
    east, north, up = one["offset_m"]
    session, off = one["session"].rpartition("/")[2], f"{east:+.1f} m east, {north:+.1f} m north, {up:+.1f} m up"
    if one["elsewhere"]:
        why = "a wrong base station, heights above the sea, or loops with a twin of its place?"
        return f"All anchors of {session} lie elsewhere, {off}: {why}"
    if one["sigma_factor"] > 1.0:
        return f"Anchors of {session} err by {one['sigma_factor']:.0f} times their stated standard deviations."
    return f"Anchors of {session} lie beside the map, {off}: another receiver contradicts them."


COLUMNS = ("anchor", "session", "state", "off m", "reason")


def _names(session: str, anchor_ids: list[str]) -> list[str]:
    return [f"{session}/anchors/{one}" for one in anchor_ids]


def _row(told: dict[str, Any]) -> tuple[Any, ...]:
    """A verdict on an anchor, by name."""
    session, _, anchor = told["name"].rpartition("/anchors/")
    residual = told.get("residual_m")
    off_m = None if residual is None else f"{math.hypot(*residual):.2f}"
    return anchor, session.rpartition("/")[2], told.get("state") or "not judged", off_m, told.get("reason")


def _listed(one: Anchor) -> tuple[Any, ...]:
    return one.kind if one.tag is None else f"{one.kind} {one.tag}", *_row(vars(one))
