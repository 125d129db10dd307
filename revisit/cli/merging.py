"""`revisit merge`: one map out of two, the evidence for and against it, and the merges so far."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.options import HTTP, Http, Json
from revisit.cli.output import emit_json, emit_table, refuse, say, utc
from revisit.cli.submap_names import map_or_session
from revisit.cli.waiting import waited

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import MapChange, MapMerge

SHOWN_CHANGES = 20


def merge(
    into: Annotated[str, typer.Argument(help="Id of the map that grows.")],
    source: Annotated[
        str, typer.Argument(help="Id of the map to merge into it, or MAP/SESSION for one session; none for a list.")
    ] = "",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only say what would happen, and what speaks for it.")
    ] = False,
    near: Annotated[
        str, typer.Option(help="Roughly where the source lies in the map: x,y,z,yaw in metres and degrees.")
    ] = "",
    radius: Annotated[float, typer.Option(help="How far from there it may lie, metres.", min=0.0)] = 30.0,
    picture: Annotated[Path | None, typer.Option(help="PNG of the tracks before and after.")] = None,
    changes: Annotated[
        bool, typer.Option("--changes", help="What vanished and what appeared, by the last merge that holds.")
    ] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Take the last merge back: its copies go, the poses from before return.")
    ] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Merge a map, or one session of it, into another map, in a worker; exit 1 where the service refuses to.

    Without SOURCE: list the merges so far, or the changes by the last one; or take that one back.
    """
    from revisit.sdk.client import Client

    if not source:
        _look_back(into, http, json, changes=changes, undo=undo)
        return
    if changes or undo:
        raise refuse("--changes and --undo are of merges so far: give no SOURCE")
    T_map_source = _pose(near)
    asked: dict[str, Any] = {} if T_map_source is None else {"T_map_source": T_map_source, "radius_m": radius}
    with Client(http) as client:
        before = _tracks(client, into) if picture is not None and not dry_run else {}
        operation = client.merge_map(f"maps/{into}", map_or_session(source), validate_only=dry_run, **asked)
        result = waited(client, operation, quiet=json).result or {}
        if picture is not None and result.get("verdict") == "MERGED":
            _draw(picture, before, _tracks(client, into), result)
    _emit_merge(result, json)


def _emit_merge(result: dict[str, Any], as_json: bool) -> None:
    """Exits with status 1 where the service refused."""
    if as_json:
        emit_json(result)
    else:
        _show(result)
    if result.get("verdict") not in ("MERGED", "MERGEABLE"):
        raise refuse(f"not merged: {result.get('refusal') or result.get('outcome')}")


def _look_back(map_id: str, http: str, as_json: bool, *, changes: bool, undo: bool) -> None:
    """The merges into a map, or the changes by the last one; or that one taken back."""
    from revisit.sdk.client import Client

    if changes and undo:
        raise refuse("give either --changes or --undo")
    with Client(http) as client:
        if changes:
            merge = _last_merge(client, map_id, "; `revisit map changes` compares drives of one map")
            _emit_changes(list(merge.changes), as_json)
        elif undo:
            _emit_undone(client.revert_merge(_last_merge(client, map_id)), as_json)
        elif as_json:
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
        _show_changes(found)


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


def _show_changes(found: list[MapChange]) -> None:
    """Vanished and new things, the largest first."""
    rows = [
        (one.kind, *(f"{value:.1f}" for value in (*one.centre_m, *one.extent_m)), one.points)
        for one in found[:SHOWN_CHANGES]
    ]
    emit_table("Changes between the days", ("", "x m", "y m", "z m", "dx", "dy", "dz", "points"), rows)
    if len(found) > SHOWN_CHANGES:
        say(f"and {len(found) - SHOWN_CHANGES} more")


def _show(result: dict[str, Any]) -> None:
    if "verdict" not in result:
        return
    evidence, limits = result["evidence"], result["limits"]
    rows = [
        ("loops that agree", f"{evidence['loops']:g}", f">= {limits['loops']:g}"),
        ("loops of another alignment", f"{evidence['rival_loops']:g}", f"< {limits['rival_share']:g} of them"),
        ("common track m", f"{evidence['common_track_m']:.1f}", f">= {limits['common_track_m']:g}"),
        ("candidates, verified", f"{evidence['candidates']:g}, {evidence['verified']:g}", ""),
    ]
    if "common_points" in evidence:
        rows += [
            ("common points", f"{evidence['common_points']:g}", f">= {limits['common_points']:g}"),
            ("overlap", f"{evidence['overlap_share']:.2f}", ""),
            ("distance from the surface m", _number(evidence["residual_m"]), f"<= {limits['median_residual_m']:g}"),
            ("looked through", f"{evidence['seen_through_share']:.4f}", f"<= {limits['seen_through_share']:g}"),
            ("in the worst stretch", f"{evidence['worst_stretch_share']:.4f}", f"<= {limits['stretch_share']:g}"),
        ]
    emit_table(f"{result['source']}: {result['verdict']}", ("evidence", "found", "needed"), rows)
    changed = result["would_change"]
    say(
        f"{changed['sessions_joined']:g} of {changed['sessions']:g} sessions join with {changed['submaps']:g} submaps; "
        f"what is there moves by {_number(changed['max_change_m'])} m at most."
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _pose(near: str) -> Any:
    """The (4, 4) transform of x,y,z,yaw; None for "". Refuses other text."""
    import numpy as np

    from revisit.core.geometry import se3

    if not near:
        return None
    try:
        x, y, z, yaw_deg = (float(part) for part in near.split(","))
    except ValueError as error:
        raise refuse("--near is x,y,z,yaw in metres and degrees") from error
    return se3.from_yaw(np.radians(yaw_deg), (x, y, z))


def _tracks(client: Any, map_id: str) -> dict[str, tuple[str, Any]]:
    """The frame and the positions (n, 2) of each session by the version in force."""
    import numpy as np

    version = client.get_map(f"maps/{map_id}").map_version
    if not version:
        return {}
    tracks: dict[str, tuple[str, list[Any]]] = {}
    for pose in client.submap_poses(f"maps/{map_id}/versions/{version}"):
        session = pose.submap.split("/")[3]
        tracks.setdefault(session, (pose.frame, []))[1].append(pose.T_map_submap[:2, 3])
    return {session: (frame, np.stack(places)) for session, (frame, places) in tracks.items()}


def _draw(picture: Path, before: Any, after: Any, result: dict[str, Any]) -> None:
    from revisit.evaluation.merge_picture import draw_merge

    draw_merge(picture, before, after, result["changes"])
