"""Versions of a map as files: saved, published, checked, compared."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse, reporter, say

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from revisit.formats.map_file import FiledSubmap, MapDifference
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Map, MapFile, MapVersion, Submap, SubmapPose

Report = Callable[[str, int, int], None]
Filed = Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="A map file.")]


def save(
    out: Annotated[Path, typer.Argument(help="File to write; NAME.vda5050.json comes beside it.")],
    map_id: MapName = "default",
    version: Annotated[int, typer.Option(min=0, help="The version; by default the one in force.")] = 0,
    around: Annotated[str, typer.Option(help="X,Y,RADIUS (m): only submaps that near, in the largest frame.")] = "",
    link: Annotated[str, typer.Option(help="Where robots will download the file: VDA 5050's mapDownloadLink.")] = "",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Save a version of a map as one file that never changes: poses, descriptors and neural maps.

    The same version gives the same bytes. Robots search and localise in it without a service.
    """
    from revisit.formats.whole_files import write_whole
    from revisit.sdk.client import Client

    with Client(http) as client, progress_bar(quiet=json) as bar:
        found = client.get_map(f"maps/{map_id}")
        chosen = _chosen(client, found, version)
        if around:
            submaps, map_hash = write_from_service(client, out, found, chosen, around, reporter(bar))
        else:
            submaps, map_hash = _published(client, out, chosen)
    document = vda5050(map_id, chosen, map_hash, link)
    write_whole(out.with_suffix(".vda5050.json"), _json(document))
    if json:
        emit_json({"file": str(out), "submaps": submaps, **document})
    else:
        say(f"{out}: version {chosen.version} of map {map_id}, {submaps} submaps, mapHash {map_hash}")


def publish(
    map_id: MapName = "default",
    version: Annotated[int, typer.Option(min=0, help="The version; by default the one in force.")] = 0,
    descriptor: Annotated[str, typer.Option(help="What the map is, in one line: VDA 5050's mapDescriptor.")] = "",
    enable: Annotated[bool, typer.Option("--enable", help="Robots are to use this version from now on.")] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Make a file of a version of a map that robots download from the service; `--enable` makes it the one to use."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        chosen = _chosen(client, client.get_map(f"maps/{map_id}"), version)
        file = _file_of(client, chosen, descriptor)
        if enable:
            file = client.enable_map_file(file)
    if json:
        emit_json(asdict(file))
    else:
        say(f"{file.name}: {file.map_status}, {file.size_bytes:,} bytes, mapHash {file.map_hash}")


def emit_files(map_id: str, found: list[MapFile], as_json: bool) -> None:
    """The published files of a map, for a program or for a person."""
    if as_json:
        emit_json([asdict(one) for one in found])
        return
    rows = [(f.map_version, f.map_status, f.submaps, f.size_bytes, f.map_hash[:12], f.map_descriptor) for f in found]
    emit_table(f"Files of map {map_id}", ("version", "status", "submaps", "bytes", "mapHash", "descriptor"), rows)


def check(
    file: Filed,
    expected: Annotated[str, typer.Option("--hash", help="The mapHash that it must have.")] = "",
    since: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="An older map file: list what changed since.")
    ] = None,
    json: Json = False,
) -> None:
    """Check every byte of a map file against its manifest and the whole against a hash; list the changes --since."""
    from revisit.formats.map_file import MapFile, difference, hash_of_file

    with MapFile.open(file) as opened:
        opened.verify()
        one, submaps, changes = opened.description, len(opened.submaps), None
        if since is not None:
            with MapFile.open(since) as older:
                changes = difference(older, opened)
    found = hash_of_file(file)
    if expected and found != expected.lower():
        raise refuse(f"{file} has the hash {found}")
    if json:
        document = {"map_id": one.map_id, "map_version": one.map_version, "submaps": submaps, "map_hash": found}
        emit_json({**document, "changes": None if changes is None else asdict(changes)})
        return
    say(f"{file}: version {one.map_version} of map {one.map_id}, {submaps} submaps, whole, mapHash {found}")
    if changes is not None:
        _show_changes(changes)


def _show_changes(found: MapDifference) -> None:
    moved = list(found.moved_m.values()) or [0.0]
    rows = [
        ("submaps added", len(found.added)),
        ("submaps removed", len(found.removed)),
        ("submaps in another frame", len(found.other_frame)),
        ("mean move of the others (m)", f"{sum(moved) / len(moved):.3f}"),
        ("largest move (m)", f"{max(moved):.3f}"),
        ("bytes that the older file has", found.bytes_known),
        ("bytes that are new", found.bytes_new),
    ]
    emit_table("Changes", ("what", "value"), rows)


def vda5050(map_id: str, version: MapVersion, map_hash: str, link: str) -> dict[str, Any]:
    """The parameters of VDA 5050's downloadMap action, and the status that a downloaded map has."""
    from revisit.sdk.vda5050 import RobotMap

    known = RobotMap(map_id, str(version.version), map_hash, link)
    return known.state() | known.parameters()


def _chosen(client: Client, found: Map, version: int) -> MapVersion:
    if not (version or found.map_version):
        raise refuse(f"{found.name} has no version yet: revisit map optimise makes one")
    return client.get_map_version(f"{found.name}/versions/{version or found.map_version}")


def _around(poses: list[SubmapPose], around: str) -> list[SubmapPose]:
    """The poses within a circle of the largest frame; all where none is given."""
    if not around:
        return poses
    try:
        x, y, radius = (float(word) for word in around.split(","))
    except ValueError as error:
        raise refuse("--around is X,Y,RADIUS, three numbers in metres") from error
    frames = [pose.frame for pose in poses]
    largest = max(dict.fromkeys(frames), key=frames.count, default="")
    return [pose for pose in poses if pose.frame == largest and math.dist(pose.T_map_submap[:2, 3], (x, y)) <= radius]


def _published(client: Client, out: Path, version: MapVersion) -> tuple[int, str]:
    """Download the file of a version, which the service makes where it has none: submaps, and mapHash.

    Bytes of an earlier attempt are not sent again.
    """
    file = client.download_map_file(_file_of(client, version, ""), out)
    return file.submaps, file.map_hash


def _file_of(client: Client, version: MapVersion, descriptor: str) -> MapFile:
    made = client.wait(client.publish_map(version, descriptor)).result or {}
    return client.get_map_file(made["map_file"])


def write_from_service(
    client: Client,
    out: Path,
    found: Map,
    version: MapVersion,
    around: str = "",
    report: Report = lambda *_: None,
) -> tuple[int, str]:
    """Write a version, or its part `around` a point, from the service; the number of submaps, and mapHash.

    Raises typer.Exit where there is nothing.
    """
    poses = _around(client.submap_poses(version), around)
    if not poses:
        raise refuse(f"version {version.version} of {found.name} has no submaps there")
    return len(poses), _write(client, out, found, version, poses, report)


def _write(client: Client, out: Path, found: Map, version: MapVersion, poses: list[SubmapPose], report: Report) -> str:
    from revisit.formats.map_file import MapDescription, write_map_file

    submaps = {one.name: one for session in client.list_sessions(found) for one in client.list_submaps(session)}
    described = [pose for pose in poses if submaps[pose.submap].state == "DESCRIBED"]
    if not described:
        raise refuse(f"no submap of {found.name} is described")
    description = MapDescription(
        map_id=found.name.partition("/")[2],
        map_version=str(version.version),
        content_hash=version.content_hash,
        created_at_ns=version.created_at_ns,
        model_version=submaps[described[0].submap].model_version or "",
        scene_scale=found.scene_scale,
        tau_m=found.tau_m,
        stride_m=found.stride_m,
        loop_policy=asdict(found.loop_policy),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    return write_map_file(out, description, _filed(client, described, submaps, report))


def _filed(
    client: Client, poses: list[SubmapPose], submaps: dict[str, Submap], report: Report
) -> Iterator[tuple[FiledSubmap, NDArray[np.float32], bytes]]:
    import numpy as np

    from revisit.formats.map_file import FiledSubmap

    for number, pose in enumerate(poses, 1):
        one, neural = submaps[pose.submap], client.download(pose.submap, "neural")
        vector = np.array(client.get_submap(one.name, full=True).descriptor, dtype=np.float32)
        filed = FiledSubmap(
            name=one.name,
            ordinal=one.ordinal,
            stamp_ns=one.stamp_ns,
            frame=pose.frame,
            T_map_submap=pose.T_map_submap,
            T_odom_submap=one.T_odom_submap,
            neural=hashlib.sha256(neural).hexdigest(),
        )
        yield filed, vector, neural
        report("submaps", number, len(poses))


def _json(value: dict[str, Any]) -> str:
    return dumps(value, indent=1) + "\n"
