"""`revisit ingest`: stream a recording into a session; a second run goes on where the first one ended."""

from __future__ import annotations

import time
import warnings
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.inspect import warn, warn_of_findings
from revisit.cli.options import GRPC, Grpc, Json, MapName
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse
from revisit.cli.recordings import Format, Mounting, Odometry, Topic, opened
from revisit.core.errors import RevisitError
from revisit.sdk.errors import NotFound

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.client import Client, ScanStream
    from revisit.sdk.resources import Session, Submap
    from revisit.sdk.spooled_stream import SpooledStream

POLL_S = 1.0


@dataclass(frozen=True)
class Target:
    """Where scans go. A new map gets `scene_scale`, one that exists must have it; None takes any.

    So does a new session its `storey`.
    """

    grpc: str
    map_id: str
    session_id: str
    scene_scale: float | None = None
    storey: str | None = None


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
    findings: tuple[str, ...]


@dataclass(frozen=True)
class Sent:
    """How many scans this run was about, and how many of them were refused or could not be read."""

    scans: int
    refused: int


@dataclass(frozen=True)
class Extent:
    """How much to do: at most `limit` scans, by way of the file `spool`; then finish, then wait for the submaps."""

    limit: int | None = None
    spool: Path | None = None
    finish: bool = True
    wait: bool = True


@needs("evaluation")
def ingest(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording.")],
    map_id: MapName = "default",
    session_id: Annotated[str, typer.Option("--session", help="Id of the session; the folder's name by default.")] = "",
    file_format: Format = "auto",
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of a new map's scene compared with a street.")
    ] = None,
    storey: Annotated[
        str | None, typer.Option(help="Storey of a building, as B2: never compared with sessions on others.")
    ] = None,
    grpc: Grpc = GRPC,
    limit: Annotated[int | None, typer.Option(min=1, help="Send at most so many scans.")] = None,
    spool: Annotated[
        Path | None, typer.Option(help="File that keeps scans on this machine until they are stored.")
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until every submap is described.")] = True,
    finish: Annotated[bool, typer.Option(help="Finish the session after the last scan.")] = True,
    json: Json = False,
) -> None:
    """Stream a recording; run it again to resume."""
    _silence_the_sdk()
    recording = opened(folder, file_format, topic, odometry, mounting)
    warn(recording)
    target = Target(grpc, map_id, session_id or recording.name, scene_scale, storey)
    try:
        _transfer(recording, target, Extent(limit, spool, finish, wait), json)
    except KeyboardInterrupt as error:
        typer.echo("revisit: interrupted; the same command goes on where this one ended", err=True)
        raise typer.Exit(130) from error


def _silence_the_sdk() -> None:
    """`warn` says the same, and more, about the whole recording."""
    from revisit.sdk.input_watch import SuspiciousInput

    warnings.simplefilter("ignore", SuspiciousInput)


def _transfer(recording: Recording, target: Target, extent: Extent, as_json: bool) -> None:
    """Send the scans that the service does not have, finish the session, wait for its submaps, report."""
    from revisit.sdk.client import Client

    count = min(len(recording), extent.limit or len(recording))
    started = time.monotonic()
    with Client.grpc(target.grpc) as client:
        session = _open_session(client, target)
        if session.state == "ACTIVE":
            sent = _send(client, session, recording, count, extent.spool, as_json)
            session = client.finish_session(session) if extent.finish else client.get_session(session.name)
        else:
            sent = Sent(0, 0)
        submaps = _described(client, session, as_json) if extent.wait else client.list_submaps(session)
        found = client.loop_closures(f"maps/{target.map_id}", state="ACCEPTED", session=session)
        session = client.get_session(session.name)
    seconds = time.monotonic() - started
    states = [submap.state for submap in submaps]
    described, failed = states.count("DESCRIBED"), states.count("FAILED")
    done = Ingested(
        session.name,
        sent.scans,
        session.committed_seq,
        sent.refused,
        len(states),
        described,
        failed,
        len(found),
        seconds,
        tuple(finding.code for finding in session.findings),
    )
    if as_json:
        emit_json(asdict(done))
    else:
        told = asdict(done) | {"findings": ", ".join(done.findings) or "none"}
        emit_table("Ingested", ("what", "value"), told.items())
        warn_of_findings(session)


def _open_session(client: Client, target: Target) -> Session:
    """The session, created with its map where they do not exist.

    Exits where the map has another scale than was asked for, or the session another storey.
    """
    map_name = f"maps/{target.map_id}"
    try:
        found = client.get_map(map_name)
    except NotFound:
        found = client.create_map(target.map_id, scene_scale=target.scene_scale)
    if target.scene_scale not in (None, found.scene_scale):
        raise refuse(f"{map_name} has scene scale {found.scene_scale:g}; a map keeps the one it was created with")
    try:
        session = client.get_session(f"{map_name}/sessions/{target.session_id}")
    except NotFound:
        return client.create_session(map_name, target.session_id, storey=target.storey)
    if target.storey not in (None, session.storey):
        raise refuse(f"{session.name} has storey {session.storey}; a session keeps the one it was created with")
    return session


def _send(client: Client, session: Session, recording: Recording, count: int, spool: Path | None, quiet: bool) -> Sent:
    """Stream the scans behind the last one that the service, or the spool, has."""
    from revisit.sdk.spool import SpoolFull

    sent, unusable = 0, 0
    with progress_bar(quiet) as bar, _stream_of(client, session, spool) as stream:
        refused_before, behind_ns = len(stream.rejected), _last_stamp_ns(client, session, stream)
        # Damaged and refused scans have no number in the session: an index is at least the number, its time tells.
        first = min(session.committed_seq, count)
        _require_same_recording(session, recording, behind_ns)
        task = bar.add_task(f"{recording.name}: scans", total=count, completed=first)
        for index in range(first, count):
            bar.advance(task)
            try:
                scan = recording.scan(index)
                if scan.stamp_ns <= behind_ns:
                    unusable = 0  # what came before was told by an earlier run
                    continue
                stream.send(scan.points, scan.T_odom_sensor, scan.stamp_ns)
                sent += 1
            except SpoolFull:
                raise
            except RevisitError:
                # A damaged or empty file of the recording costs that scan, not the drive.
                unusable += 1
        stream.flush()
        return Sent(sent, len(stream.rejected) - refused_before + unusable)


def _require_same_recording(session: Session, recording: Recording, behind_ns: int) -> None:
    """Exits unless the session's last scan is one of this recording: a second run would leave out or mix scans."""
    if behind_ns < 0:
        return
    # Its place is that of its number, or later where scans before it were refused.
    for index in range(max(0, session.committed_seq - 1), len(recording)):
        try:
            stamp_ns = recording.scan(index).stamp_ns
        except RevisitError:
            continue
        if stamp_ns == behind_ns:
            return
        if stamp_ns > behind_ns:
            break
    raise refuse(
        f"{session.name} ends with a scan of another recording (stamp {behind_ns} ns, which {recording.name} does not "
        "have at its place): give this one a session of its own, with --session NAME"
    )


def _stream_of(
    client: Client, session: Session, spool: Path | None
) -> AbstractContextManager[ScanStream] | AbstractContextManager[SpooledStream]:
    if spool is None:
        return client.stream(session)
    return client.spooled_stream(session, spool, full_wait_s=float("inf"))


def _last_stamp_ns(client: Client, session: Session, stream: ScanStream | SpooledStream) -> int:
    """When the last scan was taken that needs no sending, -1 where there is none."""
    from revisit.sdk.spooled_stream import SpooledStream

    spooled_ns = stream.state.last_stamp_ns if isinstance(stream, SpooledStream) else None
    stamp_ns = client.get_session(session.name).committed_stamp_ns if spooled_ns is None else spooled_ns
    return -1 if stamp_ns is None else stamp_ns


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
