"""A map piece by piece: its tiles, their surfaces as files, distances of points to the surface."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.moments import AsOf, Ever, moment_ns
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, refuse, say

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import MapTile

FORMATS = ("glb", "mesh", "pcd", "ply", "npy", "neural")


def tiles(
    tile_id: Annotated[str, typer.Argument(metavar="TILE", help="One of them, to download.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write the surface of TILE to.")] = None,
    map_id: MapName = "default",
    file_format: Annotated[str, typer.Option("--format", help=f"{', '.join(FORMATS)}; mesh is ply.")] = "glb",
    distance: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,Z", help="Instead: how far this point is from the surface, positive in free space."),
    ] = None,
    frame: Annotated[
        str, typer.Option(help="--distance: the frame of the map that is meant; needed where there are several.")
    ] = "",
    as_of: AsOf = "",
    ever: Ever = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the tiles of the version of a map in force, or download the surface of one; a worker makes it if need be.

    With `--distance`, which may be repeated: signed distances of points to the surface, metres. The surface is the one
    that the latest drive left, unless --as-of or --ever say otherwise.
    """
    from revisit.formats.whole_files import write_whole
    from revisit.sdk.client import Client

    if distance and tile_id:
        raise refuse("give either TILE or --distance")
    if bool(tile_id) != (out is not None):
        raise refuse("to download, give TILE and --out FILE")
    if file_format not in FORMATS:
        raise refuse(f"--format is one of {', '.join(FORMATS)}")
    moment: dict[str, Any] = {"as_of_ns": moment_ns(as_of), "ever": ever}
    with Client(http) as client:
        if distance:
            _measure(client, map_id, distance, {"frame": frame, **moment}, json)
        elif out is not None:
            version = client.get_map(f"maps/{map_id}").map_version
            data = client.download_tile(f"maps/{map_id}/versions/{version}/tiles/{tile_id}", file_format, **moment)
            write_whole(out, data)
            say(f"{out}: {len(data):,} bytes of tile {tile_id}, version {version} of map {map_id}")
        else:
            _list(map_id, client.map_tiles(f"maps/{map_id}"), json)


def _list(map_id: str, found: list[MapTile], as_json: bool) -> None:
    if as_json:
        emit_json([asdict(one) for one in found])
        return
    rows = [
        (one.name.rpartition("/")[2], *(f"{value:.1f}" for value in (*one.min_m, *one.max_m)), one.submaps, one.made)
        for one in found
    ]
    names = ("tile", "min x (m)", "min y", "max x", "max y", "submaps", "made")
    emit_table(f"Tiles of map {map_id}", names, rows)


def _measure(client: Client, map_id: str, points: list[str], where: dict[str, Any], as_json: bool) -> None:
    """Signed distances of points X,Y,Z to the surface, `where` and when."""
    try:
        asked = [[float(word) for word in point.split(",")] for point in points]
    except ValueError as error:
        raise refuse("a point is X,Y,Z, three numbers in metres") from error
    if any(len(point) != 3 for point in asked):
        raise refuse("a point is X,Y,Z, three numbers in metres")
    found = client.map_distances(f"maps/{map_id}", asked, **where)
    pairs = zip(points, found.distance_m.tolist(), found.nearest_m.tolist(), strict=True)
    rows = [(point, *(None if value != value else round(value, 4) for value in row)) for point, *row in pairs]
    if as_json:
        keys = ("point", "distance_m", "nearest_m")
        distances = [dict(zip(keys, row, strict=True)) for row in rows]
        emit_json({"map_version": found.map_version, "frame": found.frame, "distances": distances})
        return
    shown = [tuple("unknown" if value is None else value for value in row) for row in rows]
    title = f"Map {map_id}, version {found.map_version}, {found.frame}"
    emit_table(title, ("point", "to the surface (m)", "to what was seen (m)"), shown)
