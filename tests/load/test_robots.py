"""Robots with a LiDAR of 64 beams at 1.5 m/s, ten scans a second each, on one machine with the whole service.

REVISIT_ROBOTS (2) drive for REVISIT_ROBOTS_MINUTES (a third); REVISIT_ROBOTS_WORKERS (2) describe and verify with the
real method. They send REVISIT_ROBOTS_SEND: the `described` scans, as the SDK does, or `all`, over
REVISIT_ROBOTS_TRANSPORT: grpc, or rest with a request each. Full size is 16 robots for 10 minutes, or 8 that send all,
on two cores that do nothing else:

    export REVISIT_TEST_TIMES=1 REVISIT_ROBOTS=16 REVISIT_ROBOTS_MINUTES=10
    python -m pytest tests/load/test_robots.py -s

The scans are simulated beforehand (`tests.support.recorded_drive`, half a minute of a core, or 10 minutes for all) and
kept in the folder REVISIT_ROBOTS_DRIVE, where one is named. Odometry does not drift. Whether the robots are kept up
with is asked only where REVISIT_TEST_TIMES is set.
"""

from __future__ import annotations

import os
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from revisit import Client, SuspiciousInput
from revisit.formats import decode_cloud
from revisit.service.ports.blobs import CLOUD_BLOB
from tests.support.figures import publish
from tests.support.load import quantile
from tests.support.patience import eventually, in_time
from tests.support.processes import ServiceProcess
from tests.support.recorded_drive import SCANS_PER_S, SPEED_MPS, Lap, RecordedDrive, recorded_drive
from tests.support.replaying_robots import MachineWatch, Robot, stored_bytes
from tests.support.service_world import pose

ROBOTS = int(os.environ.get("REVISIT_ROBOTS", "2"))
SECONDS = 60 * float(os.environ.get("REVISIT_ROBOTS_MINUTES", "0.3333"))
TRANSPORT = os.environ.get("REVISIT_ROBOTS_TRANSPORT", "grpc")
SEND = os.environ.get("REVISIT_ROBOTS_SEND", "described")
WORKERS = int(os.environ.get("REVISIT_ROBOTS_WORKERS", "2"))
pytestmark = [pytest.mark.slow, pytest.mark.timeout(int(3 * SECONDS) + 1800)]

BLOCK_M = 85.0
SHORT_SCANS = 400
"""Of ten a second: a test that needs no more than so many drives them once; a longer one goes round the block."""

MOST_LATE_S = 2.0
MORE_QUEUED = 1.0
"""A queue that has grown by less than so many submaps for each robot between the first third and the last is flat."""

REAL = "revisit.service.adapters.core_recogniser:load_recogniser"


@pytest.fixture(scope="module")
def laps(tmp_path_factory) -> list[Lap]:
    """A place to begin for each robot: evenly spread around the block, or a metre apart."""
    folder = Path(os.environ.get("REVISIT_ROBOTS_DRIVE") or tmp_path_factory.mktemp("drive"))
    needed = round(SECONDS * SCANS_PER_S) + 10 * ROBOTS
    short = needed <= SHORT_SCANS
    drive: RecordedDrive = recorded_drive(folder, needed if short else None, BLOCK_M, described=SEND == "described")
    apart_m = SPEED_MPS if short else drive.round_m / ROBOTS
    starts = [int(np.searchsorted(drive.way_m, robot * apart_m)) for robot in range(ROBOTS)]
    return [Lap(drive, robot, start) for robot, start in enumerate(starts)]


def driven(service: ServiceProcess, laps: list[Lap]) -> tuple[list[Robot], MachineWatch]:
    """All robots drive, each in a session of its own of one map; then the queue is worked off."""
    with Client.grpc(service.grpc_target) as client:
        town = client.create_map("town")
        sessions = [client.create_session(town, f"robot{number}").name for number in range(len(laps))]
    stop, begins_s = threading.Event(), time.monotonic() + 1.0
    robots = [
        Robot(
            service.url if TRANSPORT == "rest" else service.grpc_target,
            session,
            lap,
            SECONDS * SPEED_MPS,
            begins_s + number / len(laps) / SCANS_PER_S,
            counts=SEND == "described",
        )
        for number, (session, lap) in enumerate(zip(sessions, laps, strict=True))
    ]
    watch = MachineWatch(service, stop)
    watch.start()
    for robot in robots:
        robot.start()
    for robot in robots:
        robot.join()
    stop.set()
    watch.join()
    return robots, watch


def states_of(service: ServiceProcess, robots: list[Robot]) -> list[str]:
    """The states of all submaps; the client waits where long lists are asked for too fast."""
    with Client(service.url) as client:
        return [submap.state for robot in robots for submap in client.list_submaps(robot.name)]


def figures(robots: list[Robot], watch: MachineWatch, submaps: int, home: Path) -> dict[str, Any]:
    """What it took, a scan and a submap."""
    took_ms = [1e3 * took for robot in robots for took in robot.acknowledgements.took_s]
    scans, first, last = sum(robot.scans for robot in robots), *watch.queue_of_thirds()
    return {
        "robots": ROBOTS,
        "transport": TRANSPORT,
        "send": SEND,
        "minutes": round(SECONDS / 60, 2),
        "ack_p50_p99_ms": [quantile(0.5, took_ms), quantile(0.99, took_ms)],
        "late_at_the_end_s": round(max(robot.late_s[-1] for robot in robots), 2),
        "queue_first_and_last_third": [round(first, 1), round(last, 1)],
        "queue_most": max(watch.queued),
        "queue": watch.queued[:: max(1, len(watch.queued) // 30)],
        "cpu_s_of_gateway_workers_robots": [round(s) for s in (watch.gateway_s, watch.workers_s, watch.own_s)],
        "cores_busy_by_the_service": round((watch.gateway_s + watch.workers_s) / watch.took_s, 2),
        "gateway_cpu_ms_a_scan": round(1e3 * watch.gateway_s / scans, 1),
        "stored_bytes_a_scan": round(sum(blobs := stored_bytes(home, CLOUD_BLOB)) / scans),
        "stored_clouds": len(blobs),
        "submaps": submaps,
        "worker_cpu_ms_a_submap": round(1e3 * watch.workers_s / max(1, submaps - watch.queued[-1])),
        "robots_cpu_ms_a_scan": round(1e3 * watch.own_s / scans, 1),
        "gateway_and_worker_mib": [round(watch.gateway_mib), round(watch.worker_mib)],
        "worker_own_mib": round(watch.worker_own_mib),
        "other_work_cores": round(watch.other_cores(), 2),
        "load": os.getloadavg()[0],
    }


def test_robots_are_kept_up_with(laps, tmp_path):
    service = ServiceProcess(
        tmp_path / "home", workers=WORKERS, recogniser=REAL, streams_per_client=ROBOTS, max_queued_jobs=10_000
    )
    try:
        eventually(
            lambda: len([e for e in service.events if e["event"] == "worker_ready"]) == WORKERS, "no worker", 900
        )
        robots, watch = driven(service, laps)
        with Client(service.url) as client:
            eventually(lambda: "QUEUED" not in states_of(service, robots), "submaps are left", timeout_s=1200)
            states = states_of(service, robots)
            loops = sum(1 for _ in client.loop_closures("maps/town"))
        told = figures(robots, watch, len(states), tmp_path / "home")
    finally:
        service.close()
    publish("robots", **told, loops=loops)
    assert [robot.refusals for robot in robots] == [[]] * ROBOTS
    assert [robot.committed_seq for robot in robots] == [robot.scans for robot in robots]
    assert set(states) == {"DESCRIBED"}
    assert in_time(told["late_at_the_end_s"], MOST_LATE_S)
    first, last = told["queue_first_and_last_third"]
    assert in_time(last - first, MORE_QUEUED * ROBOTS)


MOST_SDK_MS = 30.0


@pytest.mark.parametrize("columns", [3, 4], ids=["xyz", "with intensity"])
def test_a_robot_spends_little_on_what_it_does_not_send(columns, laps, tmp_path):
    seconds = max(SECONDS, 20.0)
    cloud = laps[0].scan(0)[0]
    scan = decode_cloud(cloud.data, cloud.content_type).points
    scan = np.column_stack([scan, np.arange(len(scan), dtype=np.float32) % 256])[:, :columns].copy()
    service = ServiceProcess(tmp_path / "home", workers=1)
    try:
        with Client.grpc(service.grpc_target) as client, warnings.catch_warnings():
            warnings.simplefilter("ignore", SuspiciousInput)
            client.create_map("town")
            with client.stream(client.create_session("maps/town", "monday")) as stream:
                stream.send(scan, pose(), 1)
                began_s, began_cpu_s = time.monotonic(), time.process_time()
                for number in range(1, round(seconds * SCANS_PER_S)):
                    time.sleep(max(0.0, began_s + number / SCANS_PER_S - time.monotonic()))
                    stream.send(scan, pose(number * SPEED_MPS / SCANS_PER_S), 1 + int(1e9 * number / SCANS_PER_S))
                cpu_ms = 1e3 * (time.process_time() - began_cpu_s) / seconds
    finally:
        service.close()
    publish("sdk", columns=columns, cpu_ms_a_second=round(cpu_ms, 1), not_sent=stream.skipped)
    assert stream.skipped > 0.9 * seconds * SCANS_PER_S - 1
    assert in_time(cpu_ms, MOST_SDK_MS)
