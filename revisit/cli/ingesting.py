"""ingest: stream a recording into a session; a second run goes on where the first one ended."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass

from core.errors import RevisitError
from evaluation.datasets import Recording
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse
from revisit.client import Client
from revisit.errors import NotFound
from revisit.resources import Session, Submap

POLL_S = 1.0


@dataclass(frozen=True)
class Target:
    """Where scans go. A new map gets `scene_scale`, one that exists must have it; None takes any."""

    grpc: str
    map_id: str
    session_id: str
    scene_scale: float | None = None


@dataclass(frozen=True)
class Ingested:
    """What became of a recording."""

    session: str
    scans_sent: int
    scans_stored: int
    scans_refused: int
    submaps: int
    described: int
    failed: int
    loop_closures: int
    seconds: float


def ingest(recording: Recording, target: Target, limit: int | None, wait: bool, finish: bool, as_json: bool) -> None:
    """Send the scans that the service does not have, finish the session, wait for its submaps, report."""
    count = min(len(recording), limit or len(recording))
    started = time.monotonic()
    with Client.grpc(target.grpc) as client:
        session = open_session(client, target)
        if session.state == "ACTIVE":
            sent, refused = _send(client, session, recording, count, as_json)
            session = client.finish_session(session) if finish else client.get_session(session.name)
        else:
            sent, refused = 0, 0
        submaps = _described(client, session, as_json) if wait else client.list_submaps(session)
        found = client.loop_closures(f"maps/{target.map_id}", state="ACCEPTED", session=session)
    seconds = time.monotonic() - started
    states = [submap.state for submap in submaps]
    described, failed = states.count("DESCRIBED"), states.count("FAILED")
    done = Ingested(
        session.name, sent, session.committed_seq, refused, len(states), described, failed, len(found), seconds
    )
    if as_json:
        emit_json(asdict(done))
    else:
        emit_table("Ingested", ("what", "value"), asdict(done).items())


def open_session(client: Client, target: Target) -> Session:
    """The session, created with its map where they do not exist.

    Exits where the map has another scale than was asked for.
    """
    map_name = f"maps/{target.map_id}"
    try:
        found = client.get_map(map_name)
    except NotFound:
        found = client.create_map(target.map_id, scene_scale=target.scene_scale)
    if target.scene_scale not in (None, found.scene_scale):
        raise refuse(f"{map_name} has scene scale {found.scene_scale:g}; a map keeps the one it was created with")
    try:
        return client.get_session(f"{map_name}/sessions/{target.session_id}")
    except NotFound:
        return client.create_session(map_name, target.session_id)


def _send(client: Client, session: Session, recording: Recording, count: int, quiet: bool) -> tuple[int, int]:
    """Stream the scans behind the last stored one; how many were sent and how many of them refused."""
    unusable = 0
    with progress_bar(quiet) as bar, client.stream(session) as stream:
        first = stream.committed_seq
        task = bar.add_task(f"{recording.name}: scans", total=count, completed=min(first, count))
        for index in range(first, count):
            try:
                scan = recording.scan(index)
                stream.send(scan.points, scan.T_odom_sensor, scan.stamp_ns)
            except RevisitError:
                # A damaged or empty file of the recording costs that scan, not the drive.
                unusable += 1
            bar.advance(task)
        stream.flush()
        return max(0, count - first), len(stream.rejected) + unusable


def _described(client: Client, session: Session, quiet: bool) -> list[Submap]:
    """The session's submaps once none is waiting any more."""
    with progress_bar(quiet) as bar:
        task = bar.add_task(f"{session.name}: submaps", total=None)
        while True:
            submaps = client.list_submaps(session)
            ended = sum(submap.state != "QUEUED" for submap in submaps)
            bar.update(task, total=len(submaps), completed=ended)
            if ended == len(submaps):
                return submaps
            time.sleep(POLL_S)
