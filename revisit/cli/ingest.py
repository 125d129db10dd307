"""`revisit ingest`: stream a recording into a session; a second run goes on where the first one ended."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.ids import id_of, require_id
from revisit.cli.inspect import warn, warn_of_findings
from revisit.cli.options import GRPC, HTTP, Grpc, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, progress_bar, refuse, signs, tell
from revisit.cli.recordings import Deskew, Format, Mounting, Odometry, Poses, Topic, opened
from revisit.cli.waiting import teller_of_no_worker
from revisit.core.errors import BadField, RevisitError
from revisit.sdk.errors import ApiError, NotFound

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.anchors import NewAnchor
    from revisit.sdk.client import Client, ScanStream
    from revisit.sdk.resources import LoopClosure, Session, Submap
    from revisit.sdk.scan_choice import Send
    from revisit.sdk.spooled_stream import SpooledStream
    from revisit.sdk.transport import Refusal

Limit = Annotated[
    int | None,
    typer.Option(min=1, help="Send the first so many scans; run again without it, or with more, to go on."),
]
Finish = Annotated[
    bool | None,
    typer.Option(help="Finish the session after the last scan; by default unless --limit leaves some out."),
]

POLL_S = 1.0
LOOPS_S = 60.0
"""So long the loops of the last submaps are waited for, once these are described."""

REFUSED_TOLD = 5
"""So many refused scans are told one by one."""


@dataclass(frozen=True)
class Target:
    """Where scans go. A new map gets `scene_scale` and `profile`, one that exists must have them; None takes any.

    So does a new session its `storey` and its `drift`.
    """

    grpc: str
    map_id: str
    session_id: str
    scene_scale: float | None = None
    profile: str | None = None
    storey: str | None = None
    drift: str | None = None


@dataclass(frozen=True)
class Ingested:
    """The result of an ingest."""

    session: str
    scans_sent: int
    scans_skipped: int
    scans_stored: int
    scans_refused: int
    submaps: int
    described: int
    failed: int
    loop_closures: int
    anchors: int
    seconds: float
    findings: tuple[str, ...]
    no_loops: str | None


@dataclass(frozen=True)
class RefusedScan:
    """A scan of the recording that could not be read, or that the service refused."""

    index: int
    reason: str
    message: str


@dataclass(frozen=True)
class Sent:
    """The number of scans that this run sent, refused or unreadable ones, in the order of the recording, and the number
    of those that it did not send, as no description would be made of them.
    """

    scans: int
    refused: tuple[RefusedScan, ...]
    skipped: int = 0


@dataclass(frozen=True)
class Fixes:
    """Which fixes of satellites become anchors: of `topic`, None for the one with most; none unless `wanted`.

    `antenna_m` is the antenna in the frame of the sensor.
    """

    wanted: bool = True
    topic: str | None = None
    antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def of(self, recording: Recording) -> list[NewAnchor]:
        """The anchors of a recording. Exits where it has no such topic."""
        from revisit.cli.fixes import anchors_of

        return anchors_of(recording, self.topic, self.antenna_m) if self.wanted else []


@dataclass(frozen=True)
class Extent:
    """How much to do: `send` at most the first `limit` scans, or those of them that descriptions are made of, by way of
    the file `spool`, with the `intensity` of their points if wanted; then finish, then wait for the submaps.

    With None for `finish`, the session is finished unless the limit has left scans out.
    """

    limit: int | None = None
    spool: Path | None = None
    finish: bool | None = None
    wait: bool = True
    send: Send = "described"
    columns: tuple[str, ...] = ()

    def count(self, recording: Recording) -> int:
        """How many scans of a recording this is about."""
        return min(len(recording), self.limit or len(recording))

    def left_out(self, recording: Recording) -> int:
        """How many scans lie behind them."""
        from revisit.evaluation.datasets import unposed_of

        return len(recording) + unposed_of(recording) - self.count(recording)

    def finishes(self, recording: Recording) -> bool:
        """Whether the session ends behind them."""
        return not self.left_out(recording) if self.finish is None else self.finish


@needs("service")
def ingest(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording.")],
    map_id: MapName = "default",
    session_id: Annotated[
        str, typer.Option("--session", help="Id of the session; made of the recording's name by default.")
    ] = "",
    file_format: Format = "auto",
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    poses: Poses = None,
    deskew: Deskew = True,
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of a new map's scene compared with a street.")
    ] = None,
    profile: Annotated[
        str | None, typer.Option(help="Profile of a new map: product, or paper, whose workers need torch.")
    ] = None,
    storey: Annotated[
        str | None, typer.Option(help="Storey of a building, as B2: never compared with sessions on others.")
    ] = None,
    drift: Annotated[
        str | None,
        typer.Option(help="Drift of the odometry: WHEEL, VISUAL, LIDAR_INERTIAL, or as '0.03 m/m 0.1 deg/m'."),
    ] = None,
    gnss: Annotated[
        str | None, typer.Option(help="Bags: topic of fixes of satellites, instead of the one with most.")
    ] = None,
    no_gnss: Annotated[bool, typer.Option("--no-gnss", help="Post no fixes of satellites as anchors.")] = False,
    antenna: Annotated[str, typer.Option(help="The antenna in the frame of the sensor: 'x y z', metres.")] = "0 0 0",
    http: Http = HTTP,
    grpc: Grpc = GRPC,
    limit: Limit = None,
    spool: Annotated[
        Path | None, typer.Option(help="File that keeps scans on this machine until they are stored.")
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until every submap is described.")] = True,
    finish: Finish = None,
    all_scans: Annotated[
        bool, typer.Option("--all-scans", help="Send every scan, not those alone that descriptions are made of.")
    ] = False,
    columns: Annotated[
        str,
        typer.Option(help="Columns of the points to send, too, with commas: intensity, ring, time, rgb."),
    ] = "",
    intensity: Annotated[bool, typer.Option("--intensity", help="As --columns intensity.")] = False,
    json: Json = False,
) -> None:
    """Stream a recording; run it again to resume."""
    from revisit.sdk.addresses import grpc_address

    _silence_the_sdk()
    grpc = grpc_address(grpc, http)
    require_id("--map", map_id)
    if session_id:
        require_id("--session", session_id)
    wanted = _columns(columns, intensity)
    recording = opened(folder, file_format, topic, odometry, mounting, poses, deskew, limit, wanted)
    warn(recording)
    session = session_id or id_of(recording.name, "--session")
    target = Target(grpc, map_id, session, scene_scale, profile, storey, drift)
    fixes = Fixes(not no_gnss, gnss, _point(antenna))
    try:
        extent = Extent(limit, spool, finish, wait, "all" if all_scans else "described", wanted)
        _transfer(recording, target, extent, json, fixes)
    except KeyboardInterrupt as error:
        typer.echo("revisit: interrupted; the same command goes on where this one ended", err=True)
        raise typer.Exit(130) from error


def _columns(text: str, intensity: bool) -> tuple[str, ...]:
    """The names of the columns to send, in order. Exits where there is no such column."""
    from revisit.core.point_columns import COLUMNS, INTENSITY, column

    names = {name.strip() for name in text.split(",") if name.strip()} | ({INTENSITY.name} if intensity else set())
    try:
        return tuple(sorted((column(name).name for name in names), key=list(COLUMNS).index))
    except BadField as error:
        raise refuse(f"--columns: {error.message}") from error


def _point(text: str) -> tuple[float, float, float]:
    """Three numbers. Exits where they are none."""
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError as error:
        raise refuse("--antenna must hold three numbers: 'x y z', metres") from error
    return x, y, z


def _silence_the_sdk() -> None:
    """`warn` says the same, and more, about the whole recording."""
    from revisit.sdk.input_watch import SuspiciousInput

    warnings.simplefilter("ignore", SuspiciousInput)


def _transfer(
    recording: Recording, target: Target, extent: Extent, as_json: bool, fixes: Fixes = Fixes(wanted=False)
) -> None:
    """Send fixes and the scans that the service does not have, finish the session, wait for its submaps, report.

    Exits where nothing of the recording is stored.
    """
    from revisit.sdk.client import Client

    signs.doing(f"asking the service at {target.grpc}")
    started = time.monotonic()
    with Client.grpc(target.grpc) as client:
        session = _open_session(client, target)
        anchors = client.sessions.post_anchors(session, fixes.of(recording))
        session, sent = _sent(client, session, recording, extent, as_json)
        submaps = _described(client, session, as_json) if extent.wait else client.list_submaps(session)
        found = _loops(client, session, submaps if extent.wait else [])
        session = client.get_session(session.name)
    states = [submap.state for submap in submaps]
    done = Ingested(
        session=session.name,
        scans_sent=sent.scans,
        scans_skipped=sent.skipped,
        scans_stored=session.committed_seq,
        scans_refused=len(sent.refused),
        submaps=len(states),
        described=states.count("DESCRIBED"),
        failed=states.count("FAILED"),
        loop_closures=len(found),
        anchors=len(anchors),
        seconds=time.monotonic() - started,
        findings=tuple(finding.code for finding in session.findings),
        no_loops=None if session.no_loops is None else session.no_loops.message,
    )
    _tell(done, session, as_json)
    if session.committed_seq == 0:
        raise refuse(
            f"{session.name} holds no scan, as none of {recording.name} could be stored. It is not finished: the same "
            "command sends the scans once they are right"
        )


def _tell(done: Ingested, session: Session, as_json: bool) -> None:
    if as_json:
        emit_json(asdict(done))
        return
    fields = asdict(done) | {"findings": ", ".join(done.findings) or "none"}
    emit_table("Ingested", ("what", "value"), ((what, value) for what, value in fields.items() if value is not None))
    warn_of_findings(session)


def _sent(client: Client, session: Session, recording: Recording, extent: Extent, quiet: bool) -> tuple[Session, Sent]:
    """The session with the scans that it lacked, finished where that is wanted and it holds any.

    Raises FailedPrecondition where it was finished without some of them.
    """
    from revisit.cli.resuming import require_stored

    if session.state != "ACTIVE":
        require_stored(client, session, recording, extent.count(recording))
        return session, Sent(0, ())
    sent = _send(client, session, recording, extent, quiet)
    _tell_refused(recording, sent.refused)
    session = client.get_session(session.name)
    if not session.committed_seq:
        return session, sent
    if extent.finishes(recording):
        return client.finish_session(session), sent
    left_out = extent.left_out(recording)
    if left_out and extent.finish is None:
        advice = (
            f"{session.name} is not finished: --limit leaves {left_out} scans out, which the command sends without it"
        )
        typer.echo(advice, err=True)
    return session, sent


def _tell_refused(recording: Recording, refused: tuple[RefusedScan, ...]) -> None:
    """Say on stderr which scans were refused, and why; of many, the first ones."""
    from revisit.evaluation.datasets import name_of_scan

    for scan in refused[:REFUSED_TOLD]:
        where = name_of_scan(recording, scan.index)
        typer.echo(f"{recording.name}: refused: {where}: {scan.reason}: {scan.message}", err=True)
    if len(refused) > REFUSED_TOLD:
        typer.echo(f"{recording.name}: refused: {len(refused) - REFUSED_TOLD} more scans", err=True)


def _open_session(client: Client, target: Target) -> Session:
    """The session, created with its map where they do not exist.

    Exits where the map has another scale or profile than was asked for, or the session another storey or
    drift.
    """
    map_name = f"maps/{target.map_id}"
    try:
        found = client.get_map(map_name)
    except NotFound:
        found = client.create_map(target.map_id, scene_scale=target.scene_scale, profile=target.profile)
    if target.scene_scale not in (None, found.scene_scale):
        raise refuse(f"{map_name} has scene scale {found.scene_scale:g}; a map keeps the one it was created with")
    if target.profile not in (None, found.profile):
        raise refuse(f"{map_name} is in the profile {found.profile}; a map keeps the one it was created with")
    try:
        session = client.get_session(f"{map_name}/sessions/{target.session_id}")
    except NotFound:
        return client.create_session(map_name, target.session_id, storey=target.storey, drift=target.drift)
    if target.storey not in (None, session.storey):
        raise refuse(f"{session.name} has storey {session.storey}; a session keeps the one it was created with")
    if target.drift not in (None, session.drift):
        raise refuse(f"{session.name} has drift {session.drift}; a session keeps the one it was created with")
    return session


def _send(client: Client, session: Session, recording: Recording, extent: Extent, quiet: bool) -> Sent:
    """Stream the scans behind the last one that the service, or the spool, has."""
    from revisit.cli.resuming import first_unsent, readable_or_error, sent_points

    spooled_ns = None if extent.spool is None else _emptied(client, session, extent.spool)
    session = client.get_session(session.name)
    first = first_unsent(client, session, recording, spooled_ns, extent.columns)
    count = extent.count(recording)
    sent: list[int] = []
    lacking = dict.fromkeys(extent.columns, 0)
    refused: list[RefusedScan] = []
    with progress_bar(quiet) as bar, _stream_of(client, session, extent) as stream:
        refused_before = len(stream.refusals)
        task = bar.add_task(f"{recording.name}: scans", total=count, completed=min(first, count))
        for index in range(first, count):
            bar.advance(task)
            scan = readable_or_error(recording, index)
            if isinstance(scan, RevisitError):
                # A damaged or empty file of the recording costs that scan, not the drive.
                refused.append(RefusedScan(index, scan.code.value, scan.message))
                continue
            skipped = stream.skipped
            stream.send(sent_points(scan, extent.columns), scan.T_odom_sensor, scan.stamp_ns)
            if stream.skipped == skipped:
                sent.append(index)
                lacking |= {name: count + 1 for name, count in lacking.items() if name not in scan.columns}
        stream.flush()
        skipped = stream.skipped
        refusals = stream.refusals[refused_before:]
    _tell_lacking(recording, lacking, len(sent))
    refused += [_refused_scan(refusal, order, sent, session) for order, refusal in enumerate(refusals)]
    return Sent(len(sent), tuple(sorted(refused, key=lambda scan: scan.index)), skipped)


def _tell_lacking(recording: Recording, lacking: dict[str, int], sent: int) -> None:
    """Say on stderr which columns were asked for that scans do not have, or not in a form that can be used."""
    for name, count in lacking.items():
        if count:
            typer.echo(f"{recording.name}: {name}: {count} of {sent} scans have none that can be used", err=True)


def _refused_scan(refusal: Refusal, order: int, sent: list[int], session: Session) -> RefusedScan:
    """Which scan a refusal is about: its number counts those that were stored, and `order` were refused before it."""
    place = refusal.seq - 1 - session.committed_seq + order
    return RefusedScan(sent[place], refusal.reason, refusal.message)


def _emptied(client: Client, session: Session, spool: Path) -> int | None:
    """Sends the spool's content; the time of the last scan that was put into it for this session, if any."""
    from revisit.sdk.spool import Spool

    opened = Spool(spool, session.name)
    state = opened.state
    opened.close()
    if state.pending:
        with client.spooled_stream(session, spool) as stream:
            stream.flush()
    return state.last_stamp_ns


def _stream_of(
    client: Client, session: Session, extent: Extent
) -> AbstractContextManager[ScanStream] | AbstractContextManager[SpooledStream]:
    if extent.spool is None:
        return client.stream(session, send=extent.send, on_delay=_teller_of_delays())
    return client.spooled_stream(
        session, extent.spool, full_wait_s=float("inf"), on_delay=_teller_of_delays(), send=extent.send
    )


def _teller_of_delays() -> Callable[[str, str], None]:
    """Says on stderr why the service takes no scan; each reason once."""
    shown: set[str] = set()

    def delayed(reason: str, message: str) -> None:
        if reason not in shown:
            shown.add(reason)
            tell(f"revisit: the service takes no scan now: {reason}: {message}; this waits, and goes on by itself")

    return delayed


def _described(client: Client, session: Session, quiet: bool) -> list[Submap]:
    """The session's submaps once none is waiting any more."""
    look = teller_of_no_worker(client)
    with progress_bar(quiet) as bar:
        task = bar.add_task(f"{session.name}: submaps", total=None)
        while True:
            submaps = client.list_submaps(session)
            ended = sum(submap.state != "QUEUED" for submap in submaps)
            bar.update(task, total=len(submaps), completed=ended)
            if ended == len(submaps):
                return submaps
            look()
            time.sleep(POLL_S)


def _loops(client: Client, session: Session, submaps: list[Submap]) -> list[LoopClosure]:
    """The loops of the session, once they were searched for with all of these submaps, or have taken long."""
    signs.doing("searching for the loops of the last submaps")
    map_ = session.name.partition("/sessions/")[0]
    last = max((submap.seq for submap in submaps), default=0)
    try:
        return client.loop_closures(map_, session=session, min_seq=last, min_seq_timeout_s=LOOPS_S)
    except ApiError as error:
        if error.reason != "SEQ_NOT_REACHED":
            raise
    tell("revisit: loops of the last submaps are still searched for; `revisit loops` lists them later")
    return client.loop_closures(map_, session=session)
