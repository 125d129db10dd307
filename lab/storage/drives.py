"""Drives, each streamed into a service of its own whose data are weighed when it has stopped."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lab.fleet.recording import Report, wait_for_descriptions
from lab.storage.weighing import WeighedStore, weigh
from revisit.cli.demo.own_service import running_service
from revisit.core.geometry.path import travelled_m
from revisit.core.scan import Scan
from revisit.evaluation.real_data import has_real_data, real_recording
from revisit.evaluation.simulator import HDL64, StreetGrid, build_city, drive, grid_drive, simulate
from revisit.evaluation.surfaces.scenes import TOWN_SEED
from revisit.sdk.client import Client

MAP = "drive"
CROSSINGS = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 0)]
"""Once round a block, and along its first side again."""

Drive = tuple[str, int, Iterator[Scan]]
"""Name, number of scans, and these."""


def stored_drives(out: Path, report: Report) -> Iterator[WeighedStore]:
    """The drives of the table, each weighed in its turn.

    The data of each stay in a folder of `out`, in the place of an earlier run's.

    Raises RuntimeError for a service that does not start or a submap that cannot be described.
    """
    drives = [simulated_drive()]
    if has_real_data():
        drives.append(real_drive(out))
    for number, of in enumerate(drives, 1):
        yield _stored(out / f"drive-{number}", of, report)


def simulated_drive() -> Drive:
    """A drive round a block of a made-up town, a scan a metre."""
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    way = drive(grid_drive(grid, CROSSINGS), world.ground, lane_m=1.8, spacing_m=1.0)
    seen = simulate(world, way, HDL64, TOWN_SEED)
    scans = (Scan.validated(one.points, one.T_world_sensor, one.stamp_ns) for one in seen)
    return "64 beams (simulated)", len(way), scans


def real_drive(out: Path) -> Drive:
    """The street of REVISIT_DATA."""
    street = real_recording("kitti00_head", out)
    return "64 beams (real, HDL-64)", len(street), (street.scan(index) for index in range(len(street)))


def _stored(home: Path, of: Drive, report: Report) -> WeighedStore:
    name, count, scans = of
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    positions = []
    with running_service(home) as addresses, Client.grpc(addresses.grpc) as client:
        client.create_map(MAP)
        session = client.create_session(f"maps/{MAP}", "all")
        with client.stream(session) as stream:
            for number, scan in enumerate(scans, 1):
                stream.send(scan.points, scan.T_odom_sensor, scan.stamp_ns)
                positions.append(scan.T_odom_sensor[:3, 3])
                report(f"{name} streams", number, count)
        client.finish_session(session)
        submaps = len(client.list_submaps(session))
        wait_for_descriptions(client, submaps, report)
    length_m = float(travelled_m(np.array(positions))[-1])
    return WeighedStore(name, length_m, submaps, len(positions), weigh(home / "data"))
