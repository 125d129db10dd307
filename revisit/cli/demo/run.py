"""The run of the demo: a service on this machine, two simulated robots, and the loops against the truth."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from revisit.cli.demo.report import show
from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.scan import Scan
from revisit.core.submap import Submap, SubmapBuilder
from revisit.evaluation.demo import (
    DemoDrive,
    DemoFigure,
    FoundLoop,
    LoopReport,
    Targets,
    TrueSubmap,
    compare,
    demo_drives,
    draw,
    portray,
)
from revisit.sdk.client import Client

MAP = "demo-town"
STREAMED = SubmapConfig(tau=10.0, stride=10.0)
START_S = 90.0
WORK_S = 900.0


@dataclass(frozen=True)
class Addresses:
    """Where the demo's service listens."""

    http: str
    grpc: str


def run_demo(picture: Path = Path("out/demo.png"), *, seed: int = 1, console: Console | None = None) -> int:
    """Run the whole demonstration; the exit status: 0 where every target was reached, else 1.

    The service runs in a temporary directory on free ports and is stopped at the end. `picture` is written as PNG.
    Raises RuntimeError where the service does not start or an operation fails, TimeoutError where it takes too long.
    """
    console = console or Console()
    started, targets = time.monotonic(), Targets()
    console.rule("Revisit: two simulated robots in a small town")
    patrol, visitor = demo_drives(seed)
    console.print(
        f"The patrol drives {patrol.length_m:.0f} m and meets its own way again, in the same direction and in reverse, "
        f"among moving cars and people. Its odometry is {patrol.drift_m:.1f} m off at the end. An hour later, other "
        f"cars parked, a visitor drives {visitor.length_m:.0f} m against it."
    )
    with (
        tempfile.TemporaryDirectory(prefix="revisit-demo-") as home,
        running_service(Path(home), console) as addresses,
        Client.grpc(addresses.grpc) as streaming,
        Client(addresses.http) as posting,
    ):
        streaming.create_map(MAP, tau_m=STREAMED.tau, stride_m=STREAMED.stride, min_index_gap=targets.gap)
        truth = stream_drive(streaming, patrol, console)
        truth |= post_drive(posting, visitor, len(truth), console)
        wait_for_descriptions(posting, console)
        found = accepted_loops(posting)
    report = compare(truth, found, targets)
    show(report, console)
    draw(_figure(patrol, visitor, truth, report), picture)
    console.print(f"Picture: {picture}   ({time.monotonic() - started:.0f} s in all; every scan here is simulated)")
    return 0 if report.reached else 1


@contextmanager
def running_service(home: Path, console: Console, settings: Mapping[str, str] | None = None) -> Iterator[Addresses]:
    """`python -m revisit.service serve` on free ports with its data in `home`, stopped on leaving.

    `settings` are further variables of its environment.
    """
    environment = {
        **os.environ, "REVISIT_HOME": str(home / "data"), "REVISIT_HTTP_PORT": "0", "REVISIT_GRPC_PORT": "0",
        "REVISIT_HOST": "127.0.0.1", "REVISIT_WORKERS": str(os.cpu_count() or 1), "REVISIT_LOG_LEVEL": "INFO",
        **(settings or {}),
    }  # fmt: skip
    log = home / "service.log"
    with log.open("wb") as stream:
        command = [sys.executable, "-m", "revisit.service", "serve"]
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=subprocess.STDOUT)
    try:
        addresses = _when_listening(process, log)
        console.print(f"The service listens on {addresses.http} (REST) and {addresses.grpc} (gRPC).")
        yield addresses
    finally:
        _stop(process)


def _when_listening(process: subprocess.Popen[bytes], log: Path) -> Addresses:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        for line in log.read_text(errors="replace").splitlines():
            if '"listening"' in line:
                event = json.loads(line)
                return Addresses(f"http://127.0.0.1:{event['http_port']}", f"127.0.0.1:{event['grpc_port']}")
        time.sleep(0.1)
    raise RuntimeError("the service did not start:\n" + log.read_text(errors="replace")[-3000:])


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=30.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def stream_drive(client: Client, drive: DemoDrive, console: Console) -> dict[str, TrueSubmap]:
    """Stream a drive scan by scan over gRPC; what is true of the submaps the service made of it, by name."""
    session = client.create_session(f"maps/{MAP}", drive.robot)
    with _progress(console) as progress, client.stream(session) as stream:
        task = progress.add_task(f"{drive.robot} streams scans (gRPC)", total=len(drive))
        for scan, T_odom_sensor in zip(drive.scans(), drive.T_odom_sensor, strict=True):
            stream.send(scan.points, T_odom_sensor, scan.stamp_ns)
            progress.advance(task)
    client.finish_session(session)
    windows = {}
    for submap in client.list_submaps(session):
        if submap.first_seq is None or submap.last_seq is None:
            raise RuntimeError(f"{submap.name} does not say which scans it holds")
        windows[submap.name] = range(submap.first_seq - 1, submap.last_seq)
    return _truth(drive, windows, first_order=0)


def post_drive(client: Client, drive: DemoDrive, first_order: int, console: Console) -> dict[str, TrueSubmap]:
    """Accumulate submaps on the robot and post them over REST; what is true of them, by name."""
    session = client.create_session(f"maps/{MAP}", drive.robot)
    builder = SubmapBuilder(STREAMED)
    windows: dict[str, range] = {}
    with _progress(console) as progress:
        task = progress.add_task(f"{drive.robot} posts submaps (REST)", total=len(drive))
        for index, scan in enumerate(_odometry_scans(drive)):
            progress.advance(task)
            if (window := builder.add(scan)) is None:
                continue
            submap, submap_id = Submap.from_scans(window, STREAMED), f"v-{len(windows):03d}"
            stamp_ns = window[len(window) // 2].stamp_ns
            client.post_submap(session, submap_id, submap.points, submap.T_odom_submap, stamp_ns)
            windows[f"{session.name}/submaps/{submap_id}"] = range(index + 1 - len(window), index + 1)
    return _truth(drive, windows, first_order)


def _odometry_scans(drive: DemoDrive) -> Iterator[Scan]:
    for scan, T_odom_sensor in zip(drive.scans(), drive.T_odom_sensor, strict=True):
        yield Scan.validated(scan.points, T_odom_sensor, scan.stamp_ns)


def _truth(drive: DemoDrive, windows: dict[str, range], first_order: int) -> dict[str, TrueSubmap]:
    poses = drive.trajectory.T_world_sensor
    return {
        name: TrueSubmap(
            name, drive.robot, first_order + order, poses[list(scans), :3, 3].mean(axis=0),
            poses[scans[len(scans) // 2]],
        )
        for order, (name, scans) in enumerate(windows.items())
    }  # fmt: skip


def wait_for_descriptions(client: Client, console: Console) -> None:
    """Until no job waits or runs. Raises RuntimeError for a failed job, TimeoutError after WORK_S seconds."""
    deadline = time.monotonic() + WORK_S
    with _progress(console) as progress:
        status = client.status()
        task = progress.add_task("submaps described and searched", total=None)
        while status.queued_jobs + status.running_jobs:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{status.queued_jobs} submaps still wait after {WORK_S:.0f} s")
            total = status.indexed_submaps + status.queued_jobs + status.running_jobs
            progress.update(task, completed=status.indexed_submaps, total=total)
            time.sleep(0.5)
            status = client.status()
        progress.update(task, completed=status.indexed_submaps, total=status.indexed_submaps)
    if status.failed_jobs:
        raise RuntimeError(f"{status.failed_jobs} submaps could not be described")


def accepted_loops(client: Client) -> list[FoundLoop]:
    """The loop closures of the demo's map that passed verification."""
    loops = client.loop_closures(f"maps/{MAP}", state="ACCEPTED")
    return [FoundLoop(loop.query, loop.match, loop.T_match_query) for loop in loops if loop.T_match_query is not None]


def _figure(patrol: DemoDrive, visitor: DemoDrive, truth: dict[str, TrueSubmap], report: LoopReport) -> DemoFigure:
    ways = {drive.robot: drive.trajectory.T_world_sensor for drive in (patrol, visitor)}
    builder = SubmapBuilder(STREAMED)
    window = next(window for window in map(builder.add, _odometry_scans(visitor)) if window is not None)
    return DemoFigure(ways, truth, report, portray(window, PipelineConfig()))


def _progress(console: Console) -> Progress:
    columns: tuple[Any, ...] = (
        TextColumn("{task.description:34}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    )  # fmt: skip
    return Progress(*columns, console=console)
