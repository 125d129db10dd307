"""`revisit map changes`: what appeared, vanished, moved or came back between the drives of a map."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.moments import moment_ns, since_ns
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, refuse, say, utc

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import MapChange

SHOWN = 40
_ASKED_AGAIN = 120
"""How often changes are asked for while a worker compares the drives: an hour."""


def changes(
    map_id: MapName = "default",
    since: Annotated[
        str, typer.Option(metavar="TIME", help="Found from then on: 2026-11-27, 2026-11-27T16:30, or ns since 1970.")
    ] = "",
    until: Annotated[str, typer.Option(metavar="TIME", help="Found up to then, a date included.")] = "",
    geojson: Annotated[
        Path | None, typer.Option(help="Write them as boxes of WGS 84 to this file; the map must lie on earth.")
    ] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List what drives found changed in a map: things that appeared, vanished, moved or came back.

    A worker compares the drives that share a frame of the version in force when this is asked for first.
    """
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = _found(client, map_id, since_ns(since), moment_ns(until) or 0)
    if geojson is not None:
        _write_geojson(geojson, http, map_id, found)
    if json:
        emit_json([asdict(one) for one in found])
    elif geojson is None:
        _show(map_id, found)


def _found(client: Client, map_id: str, after_ns: int, until_ns: int) -> list[MapChange]:
    """The changes, asked for again while drives are compared. Exits where that takes an hour."""
    from revisit.sdk.errors import DeadlineExceeded

    # One version: while robots drive, the next one comes before the drives of this one are compared.
    version = client.versions.name(f"maps/{map_id}")
    for _ in range(_ASKED_AGAIN):
        try:
            return client.map_changes(version, after_ns=after_ns, until_ns=until_ns)
        except DeadlineExceeded as still:
            say(f"{still.message}")
    raise refuse(f"the drives of map {map_id} are still being compared")


def _show(map_id: str, found: Sequence[MapChange]) -> None:
    rows = [
        (
            one.kind,
            utc(one.before_ns),
            utc(one.stamp_ns),
            one.session.rpartition("/")[2],
            *(f"{value:.1f}" for value in (*one.centre_m, *one.extent_m)),
            "" if one.moved_from_m is None else " ".join(f"{value:.1f}" for value in one.moved_from_m),
        )
        for one in found[-SHOWN:]
    ]
    names = ("", "after", "found", "by", "x m", "y m", "z m", "dx", "dy", "dz", "from x y z")
    emit_table(f"Changes in map {map_id}", names, rows)
    if len(found) > SHOWN:
        say(f"and {len(found) - SHOWN} before")


def _write_geojson(out: Path, http: str, map_id: str, found: Sequence[MapChange]) -> None:
    from revisit.cli.earth import changes_as_geojson, frame_on_earth
    from revisit.formats.whole_files import write_whole

    frames = {name: frame_on_earth(http, map_id, name) for name in {one.frame for one in found}}
    on_earth = {name: earth for name, earth in frames.items() if earth is not None}
    if found and not on_earth:
        raise refuse(f"map {map_id} does not lie on earth: no anchors hold its version in force")
    text = changes_as_geojson([one for one in found if one.frame in on_earth], on_earth)
    write_whole(out, jsonlib.dumps(text, indent=1) + "\n")
    say(f"{out}: {len(text['features'])} changes")
