"""A robot in a process of its own: `python -m tests.faults.thin_robot TARGET SPOOL JOURNAL ROWS`, to be killed.

It drives on, gives its stream every scan, and notes each in its journal once `send` has returned. Started again it goes
on behind the last line of the journal; behind ROWS lines it waits until all are acknowledged.
"""

from __future__ import annotations

import sys
import time
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit import Client
from revisit.core.geometry import se3
from tests.support.town import SESSION

STEP_M = 0.15
RETURNS = 20_000
"""Metres between two scans, and returns of each: a mark is 0.5 m."""
PAUSE_S = 0.02


@lru_cache(maxsize=1)
def room() -> NDArray[np.float32]:
    """Points (RETURNS, 3) around the sensor, metres."""
    return np.random.default_rng(1).uniform(-20.0, 20.0, (RETURNS, 3)).astype(np.float32)


def points(row: int) -> NDArray[np.float32]:
    """The scan of a row: no two are equal."""
    return room() + np.float32(0.001 * row)


def pose(row: int) -> se3.Matrix4:
    """Where the sensor was in the odometry frame (4, 4): on a curve of 0.1 degrees a scan."""
    turned = np.radians(0.1) * row
    return se3.from_yaw(turned, (STEP_M * row, 0.05 * np.sin(0.3 * row), 0.0))


def stamp_ns(row: int) -> int:
    """Ten scans a second."""
    return 10**8 * (row + 1)


def drive(target: str, spool: Path, journal: Path, rows: int) -> None:
    """The rest of the way, until the service has all of it."""
    done = len(journal.read_text().splitlines()) if journal.exists() else 0
    with (
        journal.open("a", buffering=1) as notes,
        Client.grpc(target) as client,
        client.spooled_stream(SESSION, spool) as stream,
    ):
        for row in range(done, rows):
            skipped = stream.skipped
            stream.send(points(row), pose(row), stamp_ns(row))
            notes.write("left out\n" if stream.skipped > skipped else "sent\n")
            if row == 0:  # the service tells the marks
                stream.flush(timeout_s=300.0)
            time.sleep(PAUSE_S)
        stream.flush(timeout_s=300.0)


if __name__ == "__main__":
    drive(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
