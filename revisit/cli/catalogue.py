"""`revisit maps` and `delete`: the maps of the service and their sessions, looked at and deleted."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.options import HTTP, Http, Json, Yes
from revisit.cli.output import confirm, emit_json, emit_table, say
from revisit.cli.submap_names import map_or_session

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Correction, LoopClosure, Session

PRODUCT = "product"
"""The profile that a map has unless another one is asked for."""


def maps(
    map_id: Annotated[str, typer.Argument(help="Id of one map: how its sessions lie, and the loops it rests on.")] = "",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List the maps, oldest first; of one map its sessions, where they lie, and how many loops hold it."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        if map_id:
            _show_map(client, map_id, json)
        else:
            _list_maps(client, json)


def delete(
    written: Annotated[str, typer.Argument(metavar="NAME", help="MAP, or MAP/SESSION.")],
    yes: Yes = False,
    http: Http = HTTP,
) -> None:
    """Delete a map with all of its sessions, or one session with its scans. It cannot be brought back."""
    from revisit.sdk.client import Client

    name = map_or_session(written)
    with Client(http) as client:
        if "/sessions/" in name:
            held = f"{client.get_session(name).submap_count} submaps"
        else:
            found = client.get_map(name)
            held = f"{found.session_count} sessions, {found.submap_count} submaps"
        confirm(f"Delete {name} with {held}?", yes)
        client.delete(name)
    say(f"{name} is deleted.")


def _list_maps(client: Client, as_json: bool) -> None:
    found = client.list_maps()
    if as_json:
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
            one.profile,
        )
        for one in found
    ]
    emit_table("Maps", ("map", "name", "sessions", "submaps", "version", "scene scale", "profile"), rows)


def _show_map(client: Client, map_id: str, as_json: bool) -> None:
    found = client.get_map(f"maps/{map_id}")
    sessions = [(session, _correction(client, session)) for session in client.list_sessions(found.name)]
    loops = client.loop_closures(found.name, state="ALL")
    if as_json:
        emit_json(
            {
                "map_version": found.map_version,
                "profile": found.profile,
                "sessions": [
                    {**asdict(one), "correction": None if correction is None else asdict(correction)}
                    for one, correction in sessions
                ],
                "loops": dict(_counted(loops)),
            }
        )
        return
    profile = "" if found.profile == PRODUCT else f", profile {found.profile}"
    title = f"Map {map_id}, version {found.map_version or '-'}{profile}"
    columns = ("session", "state", "scans", "submaps", "travelled m")
    emit_table(title, (*columns, "frame", "x m", "y m", "z m", "yaw deg", "sigma m"), [_row(*one) for one in sessions])
    for fault in (one for _, correction in sessions if correction for one in correction.odometry_faults):
        say(f"{fault.session.rpartition('/')[2]}: {fault.message}.")
    say(f"Loops: {', '.join(f'{count} {words}' for words, count in _counted(loops).items()) or 'none'}.")


def _correction(client: Client, session: Session) -> Correction | None:
    """The correction of a session, None where the map has no frame for it yet."""
    from revisit.sdk.errors import FailedPrecondition

    try:
        return client.correction(session)
    except FailedPrecondition:
        return None


def _row(session: Session, correction: Correction | None) -> tuple[Any, ...]:
    name, driven = session.name.rpartition("/")[2], f"{session.travelled_m:.1f}"
    described = (name, session.state, session.committed_seq, session.submap_count, driven)
    if correction is None:
        return (*described, "not in the map yet")
    T_map_odom = correction.T_map_odom
    yaw_deg = math.degrees(math.atan2(T_map_odom[1, 0], T_map_odom[0, 0]))
    sigma_m = math.sqrt(max(float(correction.covariance[:3, :3].trace()), 0.0))
    x, y, z = (f"{value:.2f}" for value in T_map_odom[:3, 3])
    return *described, correction.frame, x, y, z, f"{yaw_deg:.1f}", f"{sigma_m:.2f}"


def _counted(loops: list[LoopClosure]) -> Counter[str]:
    """How many loops there are of each verdict: that of the pose graph where it has one, else that of geometry."""
    words = {"IN_MAP": "in the map", "SET_ASIDE": "set aside", "UNCONNECTED": "of sessions that share no frame"}
    words |= {"AWAITS_CHAIN": "waiting for their drive to go on"}
    others = {"ACCEPTED": "not asked yet", "REJECTED": "rejected", "PROPOSED": "proposed"}
    said = (loop.graph_state or loop.reason or "" for loop in loops)
    return Counter(words.get(word, others.get(loop.state, loop.state)) for loop, word in zip(loops, said, strict=True))
