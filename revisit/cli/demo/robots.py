"""The demo's two robots: one streams its scans over gRPC, the other one posts submaps over REST."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from rich.console import Console

from revisit.cli.demo.steps import step
from revisit.core.config import SubmapConfig
from revisit.core.scan import Scan
from revisit.core.submap import Submap, SubmapBuilder
from revisit.evaluation.demo import DemoDrive, TrueSubmap
from revisit.sdk.client import Client
from revisit.sdk.input_watch import SuspiciousInput
from revisit.sdk.resources import Session

STREAMED = SubmapConfig(tau=10.0, stride=10.0)

Window: TypeAlias = tuple[int, ...]
"""The numbers of the scans of a drive that a submap is made of, from 0."""


def stream_drive(
    client: Client, map_name: str, drive: DemoDrive, console: Console
) -> tuple[dict[str, TrueSubmap], dict[str, Window]]:
    """Stream a drive scan by scan over gRPC; the true poses of its submaps, and their scans."""
    session = client.create_session(map_name, drive.robot)
    sent = list[int]()
    with step(console, f"{drive.robot} streams scans (gRPC)", len(drive)) as shown, client.stream(session) as stream:
        for index, (scan, T_odom_sensor) in enumerate(zip(drive.scans(), drive.T_odom_sensor, strict=True)):
            skipped = stream.skipped
            stream.send(scan.points, T_odom_sensor, scan.stamp_ns)
            if stream.skipped == skipped:
                sent.append(index)
            shown.advance()
    _finish(client, session)
    windows = {}
    for submap in client.list_submaps(session):
        if submap.first_seq is None or submap.last_seq is None:
            raise RuntimeError(f"{submap.name} does not say which scans it holds")
        windows[submap.name] = tuple(sent[submap.first_seq - 1 : submap.last_seq])
    return _truth(drive, windows, first_order=0), windows


def post_drive(
    client: Client, map_name: str, drive: DemoDrive, first_order: int, console: Console
) -> tuple[dict[str, TrueSubmap], dict[str, Window]]:
    """Accumulate submaps on the robot and post them over REST; their true poses, and their scans, by name."""
    session = client.create_session(map_name, drive.robot)
    builder = SubmapBuilder(STREAMED)
    windows: dict[str, Window] = {}
    indices: dict[int, int] = {}
    with step(console, f"{drive.robot} posts submaps (REST)", len(drive)) as shown:
        for index, scan in enumerate(odometry_scans(drive)):
            shown.advance()
            indices[scan.stamp_ns] = index
            if (window := builder.add(scan)) is None:
                continue
            submap, submap_id = Submap.from_scans(window, STREAMED), f"v-{len(windows):03d}"
            stamp_ns = window[len(window) // 2].stamp_ns
            client.post_submap(session, submap_id, submap.points, submap.T_odom_submap, stamp_ns)
            windows[f"{session.name}/submaps/{submap_id}"] = tuple(indices[one.stamp_ns] for one in window)
    _finish(client, session)
    return _truth(drive, windows, first_order), windows


def _finish(client: Client, session: Session) -> None:
    """End a session. Its odometry goes wrong on purpose: no warning of that is for the user."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SuspiciousInput)
        client.finish_session(session)


def odometry_scans(drive: DemoDrive, window: Window | None = None) -> Iterator[Scan]:
    """The scans of a drive, or of a part of it, with the poses that odometry gives them."""
    indices = range(len(drive)) if window is None else window
    for index, scan in zip(indices, drive.scans(window), strict=True):
        yield Scan.validated(scan.points, drive.T_odom_sensor[index], scan.stamp_ns)


def _truth(drive: DemoDrive, windows: dict[str, Window], first_order: int) -> dict[str, TrueSubmap]:
    poses = drive.trajectory.T_world_sensor
    return {
        name: TrueSubmap(
            name, drive.robot, first_order + order, np.asarray(poses[list(scans), :3, 3].mean(axis=0)),
            poses[scans[len(scans) // 2]],
        )
        for order, (name, scans) in enumerate(windows.items())
    }  # fmt: skip
