"""The drives of the fleet, streamed into a service whose data stay for later runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lab.fleet.drives import FleetDrive, fleet_drives
from lab.fleet.wrong_loops import PlacedSubmap
from revisit.cli.demo.own_service import running_service
from revisit.sdk.client import Client

MAP = "fleet"
WINDOW_M = 10.0

SETTINGS = {"REVISIT_OPTIMISE_AFTER_LOOPS": "0", "REVISIT_JOB_TIMEOUT_S": "1800"}
"""Of the service: the map is optimised when it is asked to, and may take long with thousands of wrong loops."""

_DESCRIBED_WITHIN_S = 3600.0
_TRUTH = "truth.json"

Report = Callable[[str, int, int], None]


def recorded(out: Path, seed: int, report: Report) -> list[PlacedSubmap]:
    """The submaps of the fleet with the truth about them, by session in their order; the service's data are in
    `out`/service. A second call finds the data of the first.
    """
    known = out / _TRUTH
    if not known.is_file():
        home = out / "service"
        home.mkdir(parents=True)
        with running_service(home, SETTINGS) as addresses, Client.grpc(addresses.grpc) as client:
            submaps = _streamed(client, fleet_drives(seed), report)
            wait_for_descriptions(client, len(submaps), report)
        known.write_text(json.dumps([{**vars(one), "T_world_submap": one.T_world_submap.tolist()} for one in submaps]))
    rows = json.loads(known.read_text())
    return [PlacedSubmap(**{**row, "T_world_submap": np.array(row["T_world_submap"])}) for row in rows]


def _streamed(client: Client, drives: tuple[FleetDrive, ...], report: Report) -> list[PlacedSubmap]:
    client.create_map(MAP, tau_m=WINDOW_M, stride_m=WINDOW_M)
    return [submap for drive in drives for submap in _drive(client, drive, report)]


def _drive(client: Client, drive: FleetDrive, report: Report) -> list[PlacedSubmap]:
    session = client.create_session(f"maps/{MAP}", drive.name)
    with client.stream(session) as stream:
        for number, (scan, T_odom_sensor) in enumerate(zip(drive.scans(), drive.T_odom_sensor, strict=True), 1):
            stream.send(scan.points, T_odom_sensor, scan.stamp_ns)
            report(
                f"{drive.name} streams ({drive.length_m:.0f} m, drift {100 * drive.drift:.1f} %)", number, len(drive)
            )
    client.finish_session(session)
    return [
        # The pose of a submap is that of its middle scan.
        PlacedSubmap(
            one.name, drive.name, ordinal, drive.trajectory.T_world_sensor[_middle(one.first_seq, one.last_seq)]
        )
        for ordinal, one in enumerate(client.list_submaps(session))
    ]


def _middle(first_seq: int | None, last_seq: int | None) -> int:
    """The index of the middle scan of a submap whose scans have these numbers, from 1."""
    if first_seq is None or last_seq is None:
        raise RuntimeError("a submap does not say which scans it holds")
    return first_seq - 1 + (last_seq - first_seq + 1) // 2


def wait_for_descriptions(client: Client, submaps: int, report: Report) -> None:
    """Until no job waits or runs. Raises RuntimeError for a failed job, TimeoutError after an hour."""
    deadline = time.monotonic() + _DESCRIBED_WITHIN_S
    while (status := client.status()).queued_jobs + status.running_jobs:
        if time.monotonic() > deadline:
            raise TimeoutError(f"{status.queued_jobs} submaps still wait")
        report("submaps described and searched", status.indexed_submaps, submaps)
        time.sleep(0.5)
    if status.failed_jobs:
        raise RuntimeError(f"{status.failed_jobs} submaps could not be described")
