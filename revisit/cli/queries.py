"""`revisit query` and `loops`: searches and loops of a running service."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.along import Asked, conversation, conversation_in_file, relocalise_along
from revisit.cli.explain import emit_near_misses
from revisit.cli.extras import needs
from revisit.cli.loop_decisions import decide
from revisit.cli.options import GRPC, HTTP, Grpc, Http, Json, MapName
from revisit.cli.output import counted, emit_json, emit_table, refuse, say
from revisit.cli.submap_names import full_name, session_name, short_name
from revisit.core.errors import RevisitError

if TYPE_CHECKING:
    from revisit.core.geometry.se3 import Matrix4
    from revisit.sdk.client import Client
    from revisit.sdk.resources import LoopClosure


def query(
    cloud: Annotated[
        Path | None, typer.Argument(exists=True, dir_okay=False, help="A .bin, .pcd, .ply or .npy.")
    ] = None,
    map_id: MapName = "default",
    submap: Annotated[str, typer.Option(help="Search by SESSION/SUBMAP instead of localising a cloud.")] = "",
    k: Annotated[int, typer.Option(min=1, max=100, help="How many to compare or to show.")] = 10,
    exclude_session: Annotated[str, typer.Option(help="Leave out the submaps of this session.")] = "",
    level: Annotated[
        str, typer.Option(help="Where z points up: qx,qy,qz,qw of the cloud in a level frame; else its own z is up.")
    ] = "",
    storey: Annotated[
        str, typer.Option(help="Storey that the cloud was taken on: sessions on another one are left out.")
    ] = "",
    explain: Annotated[
        bool,
        typer.Option("--explain", help="--submap: which gate stopped each near miss, and what passes it."),
    ] = False,
    file: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Localise in this map file, without a service.")
    ] = None,
    along: Annotated[
        Path | None,
        typer.Option(exists=True, help="Drive this recording instead, asking over gRPC or --file as it goes."),
    ] = None,
    every: Annotated[float, typer.Option(min=0.1, help="--along: ask so often, m.")] = 5.0,
    http: Http = HTTP,
    grpc: Grpc = GRPC,
    json: Json = False,
) -> None:
    """Say where a cloud was taken, or a recording is driven, or which submaps look like a submap."""
    from revisit.sdk.client import Client

    if along is not None:
        if cloud is not None or submap or level or explain or (file and (storey or exclude_session)):
            raise refuse("--along takes --every and, without --file, --map, --storey and --exclude-session")
        _relocalise(file, conversation(map_id, (http, grpc), storey, exclude_session), along, every, json)
        return
    if file is not None:
        if cloud is None or submap or exclude_session or level or storey or explain:
            raise refuse("--file takes a cloud and --k, nothing else")
        _localize_in_file(file, cloud, k, json)
        return
    _require_one_question(cloud, submap, storey, explain=explain)
    with Client(http) as client:
        if cloud is not None:
            where = {"T_level_query": _level(level), "storey": storey or None}
            _localize(client, map_id, cloud, k, {**where, "exclude_session": exclude_session or None}, json)
        elif explain:
            emit_near_misses(client, full_name(map_id, submap), k, json)
        else:
            _search(client, map_id, submap, k, exclude_session or None, json)


def _relocalise(
    file: Path | None, service: AbstractContextManager[Asked], along: Path, every_m: float, as_json: bool
) -> None:
    """Hold a conversation with a map file, if there is one, else with the service."""
    if file is None:
        with service as asked:
            relocalise_along(asked, along, every_m, as_json)
    else:
        _relocalise_in_file(file, along, every_m, as_json)


@needs("service")
def _relocalise_in_file(file: Path, along: Path, every_m: float, as_json: bool) -> None:
    with conversation_in_file(file) as asked:
        relocalise_along(asked, along, every_m, as_json)


def _require_one_question(cloud: Path | None, submap: str, storey: str, *, explain: bool) -> None:
    """Refuses none or both of a cloud and a submap, the storey of a submap, and an explanation of a cloud."""
    if (cloud is None) == (not submap):
        raise refuse("give either a cloud file or --submap SESSION/SUBMAP")
    if submap and storey:
        raise refuse("--storey is that of a cloud: a submap is on the storey of its session")
    if explain and not submap:
        raise refuse("--explain is about a submap: give --submap SESSION/SUBMAP")


def loops(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Id of one, to decide on it.")] = "",
    map_id: MapName = "default",
    state: Annotated[
        str | None,
        typer.Option(help="ACCEPTED, REJECTED or ALL; by default the accepted ones that the map did not set aside."),
    ] = None,
    session_id: Annotated[str, typer.Option("--session", help="Only those found by this session.")] = "",
    accept: Annotated[bool, typer.Option("--accept", help="Accept NAME, whatever its verdict.")] = False,
    reject: Annotated[bool, typer.Option("--reject", help="Reject NAME, whatever its verdict.")] = False,
    revert: Annotated[bool, typer.Option("--revert", help="Take the last decision of a person on NAME back.")] = False,
    note: Annotated[str, typer.Option(help="Why; kept with the decision.")] = "",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the loop closures of a map, or decide on one of them as a person."""
    from revisit.sdk.client import Client

    decisions = [word for word, given in (("accept", accept), ("reject", reject), ("revert", revert)) if given]
    if name or decisions or note:
        decide(map_id, name, decisions, note, http, json)
        return
    state = state and state.upper()
    if state not in (None, "ACCEPTED", "REJECTED", "ALL"):
        raise refuse("--state is ACCEPTED, REJECTED or ALL")
    with Client(http) as client:
        session = session_name(map_id, session_id) if session_id else None
        found = client.loop_closures(f"maps/{map_id}", state=state, session=session)
    _emit_loops(found, json)


def _emit_loops(found: list[LoopClosure], as_json: bool) -> None:
    if as_json:
        emit_json([asdict(loop) for loop in found])
        return
    rows = [
        (
            short_name(loop.query),
            short_name(loop.match),
            loop.state,
            "SET_ASIDE" if loop.graph_state == "SET_ASIDE" else loop.reason,
            loop.similarity,
            loop.score,
            *_planar(loop.T_match_query),
            loop.name.rpartition("/")[2],
        )
        for loop in found
    ]
    emit_table(
        counted(len(found), "loop closure"),
        ("query", "match", "verdict", "reason", "similarity", "score", "x m", "y m", "z m", "yaw deg", "loop"),
        rows,
    )


def _localize(client: Client, map_id: str, cloud: Path, k: int, where: dict[str, Any], as_json: bool) -> None:
    from revisit.formats import media_type_for_suffix
    from revisit.sdk.clouds import Cloud

    encoded = Cloud(cloud.read_bytes(), media_type_for_suffix(cloud.suffix))
    found = client.localize(f"maps/{map_id}", encoded, candidates=k, **where)
    if as_json:
        emit_json(asdict(found))
        return
    rows = [(short_name(c.submap), c.accepted, c.reason, c.similarity, c.score) for c in found.candidates]
    emit_table("Compared", ("submap", "accepted", "reason", "similarity", "score"), rows)
    if found.best is None or found.T_odom_query is None:
        count = found.on_other_storeys
        left_out = f" ({count} submaps on other storeys were left out)" if count else ""
        say(f"{unplaced([c.reason for c in found.candidates])}{left_out}.")
        return
    x, y, z = found.T_odom_query[:3, 3]
    say(f"Taken at x {x:.2f} m, y {y:.2f} m, z {z:.2f} m in the odometry frame of {short_name(found.session or '')}.")
    if found.in_map is None or found.in_map.T_map is None:
        return
    x_m, y_m, z_m, yaw_deg = _planar(found.in_map.T_map)
    say(f"In {found.in_map.frame} of the map: x {x_m} m, y {y_m} m, z {z_m} m, yaw {yaw_deg} degrees.")
    earth = client.maps.on_earth(f"maps/{map_id}").get(found.in_map.frame)
    if earth is not None:
        at = earth.pose(found.in_map.T_map)
        say(
            f"On earth: {at.latitude_deg:.7f}, {at.longitude_deg:.7f}, heading {at.heading_deg:.1f} degrees from north."
        )


def unplaced(reasons: Sequence[str | None]) -> str:
    """Why a cloud has no pose in a map, by the reasons of the candidates."""
    if "AMBIGUOUS" in reasons:
        return "Several poses in the map fit this cloud alike, so none is told; drive on and ask with --along"
    return "This place is not in the map"


@needs("service")
def _localize_in_file(file: Path, cloud: Path, k: int, as_json: bool) -> None:
    from revisit.area import AreaMap
    from revisit.formats import decode_cloud, media_type_for_suffix

    points = decode_cloud(cloud.read_bytes(), media_type_for_suffix(cloud.suffix)).points
    with AreaMap.open(file) as area:
        found = area.localize(points, candidates=k)
    if as_json:
        emit_json(asdict(found))
    elif found.best is None or found.in_map is None:
        say(f"unknown: none of {len(found.candidates)} candidates was accepted")
    else:
        x, y, z = found.in_map.T_map[:3, 3]
        yaw = math.degrees(math.atan2(found.in_map.T_map[1, 0], found.in_map.T_map[0, 0]))
        where = f"x {x:.2f} y {y:.2f} z {z:.2f} m, yaw {yaw:.1f} deg in {found.in_map.frame}"
        say(f"{where} (score {found.best.score:.2f}, {found.best.submap})")


def _level(quaternion: str) -> Matrix4 | None:
    """T_level_query (4, 4) of `qx,qy,qz,qw`, None where there is none. Exits where it is no rotation."""
    from revisit.core.geometry import se3

    if not quaternion:
        return None
    try:
        x, y, z, w = (float(number) for number in quaternion.split(","))
        return se3.from_quaternion((x, y, z, w), (0.0, 0.0, 0.0))
    except (ValueError, RevisitError) as error:
        raise refuse("--level is qx,qy,qz,qw: a unit quaternion") from error


def _search(client: Client, map_id: str, submap: str, k: int, without: str | None, as_json: bool) -> None:
    hits = client.search(f"maps/{map_id}", submap=full_name(map_id, submap), k=k, exclude_session=without)
    if as_json:
        emit_json([asdict(hit) for hit in hits])
        return
    emit_table("Most similar", ("submap", "similarity"), [(short_name(hit.submap), hit.similarity) for hit in hits])


def _planar(T_match_query: Matrix4 | None) -> tuple[str, ...]:
    """Where the match has the query: x, y, z in metres and the yaw in degrees."""
    if T_match_query is None:
        return ("", "", "", "")
    yaw_deg = math.degrees(math.atan2(T_match_query[1, 0], T_match_query[0, 0]))
    return (*(f"{value:.2f}" for value in T_match_query[:3, 3]), f"{yaw_deg:.1f}")
