"""`revisit export`: a map in files that other tools read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import what_is_missing
from revisit.cli.moments import AsOf, Ever, moment_ns
from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, progress_bar, refuse, reporter, say, signs, tell
from revisit.cli.recordings import Mounting, Odometry, Poses, Topic, opened
from revisit.cli.submap_names import session_name
from revisit.core.errors import BadField

if TYPE_CHECKING:
    from revisit.cli.map_files import MergedCloud, PlacedSubmap
    from revisit.cli.pose_graph_files import Graph
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.earth import OnEarth

TEXTS = ("g2o", "tum", "csv")
FILES = (
    "scans",
    "kitti",
    "ply",
    "pcd",
    "laz",
    "copc",
    "mesh",
    "glb",
    "grid",
    "mcap",
    "reference",
    "autoware",
    "3dtiles",
    "geojson",
)

PROJECTED = ("laz", "copc")
"""The formats that can be in a projected reference system."""

SURFACES = ("ply", "pcd", "laz", "copc", "mesh", "glb", "grid", "mcap", "autoware")
"""The formats with a surface, of which a later drive may have looked through a part."""

MESHES = ("mesh", "glb")
"""Those that are made of neural maps alone."""

Report = Callable[[str, int, int], None]
Writer = Callable[..., dict[str, int]]
"""Writes a map to a path; counts for the summary."""


def export(
    map_id: MapName = "default",
    file_format: Annotated[
        str,
        typer.Option(
            "--format",
            help="g2o, tum, csv, scans, kitti, ply, pcd, laz, copc (cloud), mesh (ply), glb (mesh), grid, mcap, "
            "reference, geojson (drives), autoware, 3dtiles (the last two write folders).",
        ),
    ] = "g2o",
    session_id: Annotated[str, typer.Option("--session", help="Only this session; tum and scans need one.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; g2o, tum and csv go to stdout by default.")] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            help="scans: the recording that the session was ingested from, with the options that say how it is read.",
        ),
    ] = None,
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    poses: Poses = None,
    frame: Annotated[
        str, typer.Option(help="map, or enu: metres east, north and up from the origin of a map on earth.")
    ] = "map",
    as_of: AsOf = "",
    ever: Ever = False,
    epsg: Annotated[
        int,
        typer.Option(
            min=0,
            help="laz, copc: projected reference system, such as 25832. A map on earth is written in it (extra crs); "
            "of another map it is the one that its frame is in.",
        ),
    ] = 0,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Write a map: pose graph (g2o), loops (csv), a session's odometry (tum), every scan of its recording in the map
    (scans, as tum), poses of submaps in the map (kitti), one cloud (ply, pcd, laz; copc with extra crs), one mesh
    (mesh, glb), an occupancy grid (grid), poses and cloud for Foxglove (mcap), pairs of points for fleet adapters
    (reference), a folder with the cloud in squares as Autoware loads it (autoware), one with the tiles of the surface
    for web viewers (3dtiles), or the drives on earth (geojson). Poses are those of the version in force, or else
    optimised here. A map that anchors hold lies on earth in autoware, 3dtiles and geojson, with --frame enu and with
    --epsg. Clouds, meshes, grids and tiles show what the latest drive left, unless --as-of or --ever say otherwise.
    """
    _require_fitting(file_format, session_id, recording, out)
    if (as_of or ever) and file_format in (*TEXTS, "scans"):
        raise refuse(f"--format {file_format} writes what was driven: --as-of and --ever are of surfaces and poses")
    if frame not in ("map", "enu"):
        raise refuse("--frame is map or enu")
    if epsg and (file_format not in PROJECTED or frame == "enu"):
        raise refuse("--epsg is of --format laz and copc, without --frame")
    try:
        if file_format == "scans" and recording is not None and out is not None:
            read = opened(recording, "auto", topic, odometry, mounting, poses)
            summary = _write_scans(out, http, (map_id, session_id), read)
        elif out is None or file_format in TEXTS:
            summary = _write_text(file_format, out, http, map_id, session_id)
        else:
            asked = Asked(http, (map_id, session_id), epsg, frame, moment_ns(as_of), ever)
            summary = _write_file(file_format, out, asked)
    except ModuleNotFoundError as error:
        raise refuse(what_is_missing("crs" if error.name in ("pyproj", "copclib") else "service", error)) from error
    except BadField as error:
        raise refuse(error.message) from error
    if json and out is not None:
        emit_json(summary)
    elif out is not None:
        counts = ", ".join(f"{value} {name.replace('_', ' ')}" for name, value in summary.items() if name != "file")
        say(f"{out}: {counts}")


def _require_fitting(file_format: str, session_id: str, recording: Path | None, out: Path | None) -> None:
    """Refuses a format that is none, or that lacks what it writes of."""
    if file_format not in TEXTS + FILES:
        raise refuse(f"--format is one of {', '.join(TEXTS + FILES)}")
    if file_format in ("tum", "scans") and not session_id:
        raise refuse(f"--format {file_format} writes one trajectory: give --session")
    if file_format == "scans" and recording is None:
        raise refuse("--format scans needs --recording: the service keeps no pose of a single scan")
    if file_format in FILES and out is None:
        raise refuse(f"--format {file_format} needs --out")


def _write_text(file_format: str, out: Path | None, http: str, map_id: str, session_id: str) -> dict[str, Any]:
    """A graph, a trajectory or a table, to a file or to stdout; a summary."""
    from revisit.cli.pose_graph_files import as_csv, as_g2o, as_tum, read_graph
    from revisit.formats.whole_files import write_whole

    writers: dict[str, Callable[[Graph], str]] = {"g2o": as_g2o, "tum": as_tum, "csv": as_csv}
    graph = read_graph(http, map_id, session_id)
    text = writers[file_format](graph)
    if out is None:
        say(text.rstrip("\n"))
    else:
        write_whole(out, text)
    return {"file": str(out), "submaps": sum(map(len, graph.tracks)), "loops": len(graph.loops)}


@dataclass(frozen=True)
class Asked:
    """The map and session of a file, its reference system, its frame, and which of its drives count."""

    http: str
    chosen: tuple[str, str]
    epsg: int
    frame: str
    as_of_ns: int | None
    ever: bool


def _write_file(file_format: str, out: Path, asked: Asked) -> dict[str, Any]:
    """Poses, a cloud, a mesh or a grid, with a bar; a summary."""
    from revisit.cli.earth import frame_on_earth, placed_on
    from revisit.cli.map_files import placed_submaps

    http, chosen, frame, epsg = asked.http, asked.chosen, asked.frame, asked.epsg
    if file_format == "3dtiles":
        return _write_tileset(out, asked)
    placed = placed_submaps(http, *chosen)
    if asked.as_of_ns is not None:
        placed = [one for one in placed if one.stamp_ns <= asked.as_of_ns]
    if not placed:
        raise refuse(f"map {chosen[0]} holds no submaps")
    submaps = len(placed)
    if file_format in SURFACES:
        placed = _with_surface(placed, file_format, asked)
    on_earth = epsg or frame == "enu" or file_format in ("autoware", "geojson")
    earth = frame_on_earth(http, chosen[0], placed[0].frame) if on_earth else None
    if earth is None and (frame == "enu" or file_format == "geojson"):
        raise refuse(f"map {chosen[0]} does not lie on earth: no anchors hold its version in force")
    if earth is not None and not epsg and file_format != "geojson":
        placed = placed_on(earth, placed)
    if earth is not None and epsg:  # before a cloud is made, which takes long
        earth.projected(placed[0].T_map_submap[None, :3, 3], epsg)
    out.parent.mkdir(parents=True, exist_ok=True)
    signs.doing(f"making {out}")
    with progress_bar(quiet=False) as bar:
        more: dict[str, Writer] = {
            **{kind: partial(_write_cloud, kind=kind, epsg=epsg, earth=earth if epsg else None) for kind in PROJECTED},
            "autoware": partial(_write_autoware, earth=earth),
            "geojson": partial(_write_geojson, earth=earth),
        }
        write = (_WRITERS | more)[file_format]
        if file_format in SURFACES:
            write = partial(write, ever=asked.ever)
        counts = write(out, http, placed, reporter(bar))
    of_scans = file_format in SURFACES and file_format not in MESHES
    without_scans = sum(not one.has_scans for one in placed) if of_scans else 0
    less = {"left_out": submaps - len(placed), "of_surfaces": without_scans}
    told = {name: count for name, count in less.items() if count}
    return {"file": str(out), "submaps": len(placed), **told, **counts}


def _with_surface(placed: list[PlacedSubmap], file_format: str, asked: Asked) -> list[PlacedSubmap]:
    """The submaps that have their neural maps. Exits where none has, or retention has removed the last view of then."""
    import numpy as np

    from revisit.core.merge.evidence import lost_views
    from revisit.sdk.client import Client

    map_id, kept = asked.chosen[0], [one for one in placed if not one.released]
    if not kept:
        raise refuse(f"the policy of retention of map {map_id} has removed what --format {file_format} is made of")
    if asked.as_of_ns is not None and len(kept) < len(placed):
        with Client(asked.http) as client:
            stride_m = client.get_map(f"maps/{map_id}").stride_m
        places_m = np.stack([one.T_map_submap[:2, 3] for one in placed])
        gone = np.array([one.released for one in placed])
        lost = lost_views(places_m, np.array([one.stamp_ns for one in placed]), gone, stride_m)
        if lost:
            raise refuse(f"the policy of retention of map {map_id} has removed {lost} neural maps of that moment")
    return kept


def _write_scans(out: Path, http: str, chosen: tuple[str, str], recording: Recording) -> dict[str, Any]:
    """Every scan of the recording of a session in the map; how many. Exits where it is another recording."""
    from revisit.cli.map_files import placed_submaps
    from revisit.cli.resuming import has_place
    from revisit.cli.scan_trajectory import corrections_of, trajectory_lines
    from revisit.formats.whole_files import write_whole
    from revisit.sdk.client import Client

    session = session_name(*chosen)
    with Client(http) as client:
        submaps = client.list_submaps(session)
    if not all(has_place(recording, submap) for submap in submaps):
        raise refuse(
            f"{recording.name} is not the recording of {session}, or was read otherwise: give the --topic, --odometry, "
            "--T-body-sensor and --poses that `revisit ingest` was given"
        )
    placed = {one.name: one.T_map_submap for one in placed_submaps(http, *chosen)}
    corrections = corrections_of(submaps, placed)
    if not corrections:
        raise refuse(f"{session} has no submap in the map yet")
    write_whole(out, trajectory_lines(recording, corrections))
    return {"file": str(out), "scans": len(recording), "submaps": len(corrections)}


def _write_kitti(out: Path, _http: str, placed: list[PlacedSubmap], _report: Report) -> dict[str, int]:
    """`out` and, beside it, NAME.times.txt."""
    from revisit.cli.map_files import as_kitti
    from revisit.formats.whole_files import write_whole

    poses, times = as_kitti(placed)
    write_whole(out, poses)
    write_whole(out.with_suffix(".times.txt"), times)
    return {}


def _write_cloud(
    out: Path,
    http: str,
    placed: list[PlacedSubmap],
    report: Report,
    kind: str,
    epsg: int = 0,
    earth: OnEarth | None = None,
    ever: bool = False,
) -> dict[str, int]:
    """One cloud; of a map on `earth` in the projected system `epsg`."""
    write = _cloud_writer(kind, epsg)  # before a cloud is made, which takes long
    cloud = _cloud_of(http, placed, report, ever)
    points = cloud.points if earth is None else earth.projected(cloud.points, epsg)
    write(out, points, columns=cloud.columns)
    return {"points": len(cloud.points)}


def _cloud_of(http: str, placed: list[PlacedSubmap], report: Report, ever: bool) -> MergedCloud:
    """The cloud of a map; columns that are left out are told on stderr."""
    from revisit.cli.map_files import merged_cloud

    cloud = merged_cloud(http, placed, report, ever=ever)
    for name in cloud.left_out:
        tell(f"revisit: {name} is left out: some submaps have none; --session writes one drive")
    return cloud


def _cloud_writer(kind: str, epsg: int) -> Callable[..., object]:
    """Writes points, and their columns, to a path. Raises ModuleNotFoundError, and BadField for another system."""
    from revisit.formats.whole_files import write_whole

    if kind == "copc":
        from revisit.formats import copc
        from revisit.sdk.earth import wkt

        return partial(copc.write, wkt=wkt(epsg) if epsg else "")
    from revisit.formats import laz, pcd, ply

    as_laz = partial(laz.encode, epsg=epsg or None)
    encoders: dict[str, Callable[..., bytes]] = {"ply": ply.encode, "pcd": pcd.encode, "laz": as_laz}
    return lambda out, points, columns: write_whole(out, encoders[kind](points, columns=columns))


def _write_mesh(
    out: Path, http: str, placed: list[PlacedSubmap], report: Report, kind: str, ever: bool = False
) -> dict[str, int]:
    from revisit.cli.map_files import merged_mesh
    from revisit.formats import glb, ply
    from revisit.formats.whole_files import write_whole

    vertices, normals, faces = merged_mesh(http, placed, report, ever=ever)
    write_whole(out, (glb if kind == "glb" else ply).encode_mesh(vertices, normals, faces))
    return {"vertices": len(vertices), "faces": len(faces)}


def _write_grid(out: Path, http: str, placed: list[PlacedSubmap], report: Report, ever: bool = False) -> dict[str, int]:
    """`out` as PGM and, beside it, NAME.yaml."""
    from revisit.cli.map_files import merged_cloud
    from revisit.formats.occupancy_grid import grid_of
    from revisit.formats.whole_files import write_whole

    grid = grid_of(merged_cloud(http, placed, report, ever=ever).points)
    write_whole(out, grid.to_pgm())
    write_whole(out.with_suffix(".yaml"), grid.to_yaml(out.name))
    return {"rows": grid.cells.shape[0], "columns": grid.cells.shape[1]}


def _write_mcap(out: Path, http: str, placed: list[PlacedSubmap], report: Report, ever: bool = False) -> dict[str, int]:
    from revisit.cli.map_files import by_session
    from revisit.formats.mcap_map import encode
    from revisit.formats.whole_files import write_whole

    sessions, cloud = by_session(placed), _cloud_of(http, placed, report, ever)
    write_whole(out, encode(sessions, cloud.points, columns=cloud.columns))
    return {"sessions": len(sessions), "points": len(cloud.points)}


def _write_reference(out: Path, http: str, placed: list[PlacedSubmap], _report: Report) -> dict[str, int]:
    from json import dumps

    from revisit.cli.map_files import reference_points
    from revisit.formats.whole_files import write_whole

    found = reference_points(http, placed)
    write_whole(out, dumps(found, indent=1) + "\n")
    return {"sessions": len(found)}


def _write_geojson(
    out: Path, _http: str, placed: list[PlacedSubmap], _report: Report, earth: OnEarth | None
) -> dict[str, int]:
    """The drives of a map on earth; one that is not there is refused before."""
    from revisit.cli.earth import as_geojson
    from revisit.formats.whole_files import write_whole

    if earth is not None:
        write_whole(out, as_geojson(placed, earth))
    return {}


def _write_autoware(
    out: Path, http: str, placed: list[PlacedSubmap], report: Report, earth: OnEarth | None, ever: bool = False
) -> dict[str, int]:
    """A folder of squares as PCD, their places, and the projector of a map on earth, or of one that is not."""
    from revisit.formats import autoware, pcd
    from revisit.formats.whole_files import write_whole

    cloud = _cloud_of(http, placed, report, ever)
    (out / autoware.CLOUDS).mkdir(parents=True, exist_ok=True)
    corners = []
    for corner, rows in autoware.squares_of(cloud.points):
        part = cloud.at(rows)
        write_whole(out / autoware.CLOUDS / autoware.file_of(corner), pcd.encode(part.points, part.columns))
        corners.append(corner)
    write_whole(out / autoware.METADATA, autoware.metadata_of(corners))
    projector = autoware.LOCAL_PROJECTOR if earth is None else autoware.projector_of(earth.origin)
    write_whole(out / autoware.PROJECTOR, projector)
    return {"points": len(cloud.points), "squares": len(corners)}


def _write_tileset(out: Path, asked: Asked) -> dict[str, Any]:
    """A folder with the tiles of the version in force as GLB, and the file that lists them; a summary."""
    from revisit.cli.earth import frame_on_earth
    from revisit.formats.glb import bounds_of_scene
    from revisit.formats.tileset import NAME, TileFile, tileset
    from revisit.formats.whole_files import write_whole
    from revisit.sdk.client import Client

    http, (map_id, session_id) = asked.http, asked.chosen
    if session_id:
        raise refuse(
            "--format 3dtiles writes the version of the map in force, all its sessions: --session is of others"
        )
    with Client(http) as client, progress_bar(quiet=False) as bar:
        report, written, listed = reporter(bar), [], client.map_tiles(f"maps/{map_id}")
        largest = max((tile.frame for tile in listed), key=[tile.frame for tile in listed].count, default="")
        tiles = [tile for tile in listed if tile.frame == largest]
        out.mkdir(parents=True, exist_ok=True)
        for number, tile in enumerate(tiles, 1):
            data = client.download_tile(tile, "glb", as_of_ns=asked.as_of_ns, ever=asked.ever)
            if bounds := bounds_of_scene(data):
                written.append(TileFile(f"{tile.name.rpartition('/')[2]}.glb", bounds))
                write_whole(out / written[-1].uri, data)
            report("tiles", number, len(tiles))
    if not written:
        raise refuse(f"map {map_id} has no version with a surface yet")
    earth = frame_on_earth(http, map_id, largest)
    write_whole(out / NAME, tileset(written, None if earth is None else earth.T_ecef_map))
    return {"file": str(out / NAME), "tiles": len(written)}


_WRITERS: dict[str, Writer] = {
    "kitti": _write_kitti,
    "ply": partial(_write_cloud, kind="ply"),
    "pcd": partial(_write_cloud, kind="pcd"),
    "mesh": partial(_write_mesh, kind="ply"),
    "glb": partial(_write_mesh, kind="glb"),
    "grid": _write_grid,
    "mcap": _write_mcap,
    "reference": _write_reference,
}
