"""The run of the demo: a service on this machine, two simulated robots, their map, and all of it against the truth."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from revisit.cli.demo.own_service import running_service
from revisit.cli.demo.report import show, show_map
from revisit.cli.demo.robots import STREAMED, Window, odometry_scans, post_drive, stream_drive
from revisit.cli.demo.steps import Step, step
from revisit.core.config import PipelineConfig
from revisit.evaluation.demo import (
    ClosingPair,
    DemoDrive,
    DemoFigure,
    FoundLoop,
    LoopReport,
    MapReport,
    PairClouds,
    Targets,
    TrueSubmap,
    closing_pair,
    compare,
    demo_drives,
    draw,
    judge_map,
    portray,
)
from revisit.formats import NPY, decode_cloud
from revisit.sdk.client import Client
from revisit.sdk.resources import LoopClosure, Submap

MAP = "maps/demo-town"
WORK_S = 900.0


@dataclass(frozen=True)
class Drives:
    """The drives: true poses of the submaps, and their scans, by name."""

    drives: tuple[DemoDrive, ...]
    truth: dict[str, TrueSubmap]
    windows: dict[str, Window]


@dataclass(frozen=True)
class Outcome:
    """The service's answers about the drives."""

    loops: LoopReport
    map: MapReport
    pair: PairClouds | None


def run_demo(picture: Path = Path("out/demo.png"), *, seed: int = 1, console: Console | None = None) -> int:
    """Run the whole demonstration; the exit status: 0 where every target was reached, else 1.

    The service runs in a temporary directory on free ports and is stopped at the end. `picture` is written as PNG.
    Raises RuntimeError where the service does not start or an operation fails, TimeoutError where it takes too long.
    """
    console = console or Console()
    started, targets = time.monotonic(), Targets()
    console.rule("Revisit: two simulated robots in a small town")
    with step(console, "a town and its streets are made up"):
        robots = demo_drives(seed)
    _introduce(*robots, console)
    with tempfile.TemporaryDirectory(prefix="revisit-demo-") as home:
        driven, outcome = _in_a_service(Path(home), robots, targets, console)
    show(outcome.loops, console)
    show_map(outcome.map, console)
    with step(console, "the picture is drawn"):
        draw(_figure(driven, outcome), picture)
    console.print(f"Picture: {picture}   ({time.monotonic() - started:.0f} s in all; every scan here is simulated)")
    return 0 if outcome.loops.reached and outcome.map.better else 1


def _introduce(patrol: DemoDrive, visitor: DemoDrive, console: Console) -> None:
    console.print(
        f"The patrol drives {patrol.length_m:.0f} m and meets its own way again, in the same direction and in reverse, "
        f"among moving cars and people. Its odometry is {patrol.drift_m:.1f} m off at the end. An hour later, other "
        f"cars parked, a visitor drives {visitor.length_m:.0f} m against it and does not know where the patrol began."
    )


def _in_a_service(
    home: Path, robots: tuple[DemoDrive, DemoDrive], targets: Targets, console: Console
) -> tuple[Drives, Outcome]:
    with ExitStack() as opened:
        with step(console, "the service starts"):
            addresses = opened.enter_context(running_service(home))
        console.print(f"It listens on {addresses.http} (REST) and {addresses.grpc} (gRPC).")
        streaming = opened.enter_context(Client.grpc(addresses.grpc))
        posting = opened.enter_context(Client(addresses.http))
        town = MAP.partition("/")[2]
        streaming.create_map(town, tau_m=STREAMED.tau, stride_m=STREAMED.stride)
        truth, windows = stream_drive(streaming, MAP, robots[0], console)
        visited = post_drive(posting, MAP, robots[1], len(truth), console)
        driven = Drives(robots, truth | visited[0], windows | visited[1])
        wait_for_descriptions(posting, console)
        outcome = _outcome(posting, driven, targets, console)
        with step(console, "the service stops"):
            opened.close()
        return driven, outcome


def wait_for_descriptions(client: Client, console: Console) -> None:
    """Until no job waits or runs. Raises RuntimeError for a failed job, TimeoutError after WORK_S seconds."""
    deadline = time.monotonic() + WORK_S
    with step(console, "submaps are described and searched") as shown:
        while _unfinished(client, shown):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{shown.words} submaps after {WORK_S:.0f} s")
            time.sleep(0.5)
    status = client.status()
    if status.failed_jobs:
        raise RuntimeError(f"{status.failed_jobs} submaps could not be described")


def _unfinished(client: Client, shown: Step) -> bool:
    status = client.status()
    waiting = status.queued_jobs + status.running_jobs
    shown.done, shown.total = status.indexed_submaps, status.indexed_submaps + waiting
    return waiting > 0


def _outcome(client: Client, driven: Drives, targets: Targets, console: Console) -> Outcome:
    with step(console, "one map is made of both drives"):
        client.wait(client.optimise_map(MAP), WORK_S)
        submaps = [submap for session in client.list_sessions(MAP) for submap in client.list_submaps(session)]
        found = client.loop_closures(MAP, state="ACCEPTED")
        loops = [FoundLoop(one.query, one.match, one.T_match_query) for one in found if one.T_match_query is not None]
        report = compare(driven.truth, loops, targets)
        poses = {submap.name: submap.T_odom_submap for submap in submaps}
        pair = closing_pair(report.loops, driven.truth, poses)
        return Outcome(report, _judged_map(client, driven, submaps, found), _clouds(client, pair))


def _judged_map(client: Client, driven: Drives, submaps: list[Submap], loops: list[LoopClosure]) -> MapReport:
    robots = {drive.robot: client.correction(f"{MAP}/sessions/{drive.robot}").T_map_odom for drive in driven.drives}
    return judge_map(
        driven.truth,
        {submap.name: submap.T_odom_submap for submap in submaps},
        {submap.name: submap.in_map.T_map for submap in submaps if submap.in_map is not None},
        robots,
        (sum(one.graph_state == "IN_MAP" for one in loops), sum(one.graph_state == "SET_ASIDE" for one in loops)),
    )


def _clouds(client: Client, pair: ClosingPair | None) -> PairClouds | None:
    if pair is None:
        return None
    return PairClouds(pair, _points(client, pair.loop.query), _points(client, pair.loop.match))


def _points(client: Client, submap: str) -> NDArray[np.float32]:
    return decode_cloud(client.download(submap, "npy"), NPY).points


def _figure(driven: Drives, outcome: Outcome) -> DemoFigure:
    portrayed = outcome.pair.pair.loop.match if outcome.pair else min(driven.windows)
    drive = next(one for one in driven.drives if one.robot == driven.truth[portrayed].robot)
    scans = list(odometry_scans(drive, driven.windows[portrayed]))
    positions = {name: submap.position for name, submap in driven.truth.items()}
    return DemoFigure(outcome.map, outcome.loops, positions, outcome.pair, portray(scans, PipelineConfig()))
