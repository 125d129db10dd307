"""A robot that sends the described scans alone: gateway, link and the robot itself are killed at random moments."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from revisit import Client
from revisit.core.config import SubmapConfig
from revisit.core.scan_marks import ScanMarks, marked_rows, way_along
from tests.faults import thin_robot
from tests.faults.proxy import Fault, bad_link
from tests.faults.survey import opened, survey
from tests.support.campaigns import Campaign, seed_of_this_run, sizes
from tests.support.patience import PATIENCE_S, eventually
from tests.support.processes import ROOT, ForkedService
from tests.support.records import TENANT
from tests.support.town import SESSION

MARKS = ScanMarks.of(SubmapConfig())
ROWS_A_KILL = 80
"""Scans of the way between two kills."""


class Robot:
    """The process of a robot; its spool and journal outlive it."""

    def __init__(self, target: str, folder: Path, rows: int) -> None:
        self.journal = folder / "journal"
        arguments = [target, str(folder / "spool"), str(self.journal), str(rows)]
        self._command = [sys.executable, "-m", "tests.faults.thin_robot", *arguments]
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(self._command, cwd=ROOT, start_new_session=True)

    def kill(self) -> None:
        """And start it again."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        self.start()

    @property
    def noted(self) -> list[str]:
        """The outcome of each scan for which `send` has returned."""
        return self.journal.read_text().splitlines() if self.journal.exists() else []

    def arrives(self) -> bool:
        return self._process.wait(timeout=PATIENCE_S + 300.0) == 0

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


@contextmanager
def streaming(folder: Path, rows: int, faults: random.Random):
    """A service, a link to it of which every third connection is cut, and a robot that drives."""
    folder.mkdir(exist_ok=True)
    with closing(ForkedService(folder / "home", workers=0)) as service:
        with Client(service.url) as client:
            client.create_session(client.create_map("town"), "monday")
        cuts = lambda: Fault(cut_after=faults.randint(0, 3_000_000) if faults.random() < 0.3 else sys.maxsize)  # noqa: E731
        with bad_link(service.grpc_target, cuts) as link, closing(Robot(link.address, folder, rows)) as robot:
            eventually(lambda: len(robot.noted) > 1, "the robot does not set out")
            yield service, link, robot


def kill_gateway(service: ForkedService, link) -> None:
    service.kill()
    service.start()
    link.target = service.grpc_target


def _wait_for_a_scan(service: ForkedService, robot: Robot) -> None:
    """Until the service has one more, or the robot has come home."""
    with Client(service.url) as client:
        before = client.get_session(SESSION).committed_seq
        eventually(lambda: robot.ended or client.get_session(SESSION).committed_seq > before, "nothing more comes")


def stored(folder: Path) -> list[tuple[int, float]]:
    """Row and metres travelled of the scans in the store, in the order of their numbers."""
    with opened(folder / "home") as (uow, _):
        found = sorted(uow.scans.find(TENANT), key=lambda scan: scan.seq)
    return [(scan.stamp_ns // 10**8 - 1, scan.travelled_m) for scan in found]


def least_rows(rows: int) -> list[int]:
    """The rows that a robot sends which knows its marks from the beginning and is never killed."""
    return marked_rows([(thin_robot.pose(row), thin_robot.RETURNS) for row in range(rows)], MARKS)


@pytest.mark.parametrize("kills", sizes("THINNED_KILLS", 1, 40))
@pytest.mark.timeout(7200)
def test_a_thinned_stream_loses_no_mark_when_gateways_die_and_links_are_cut(folder, kills):
    rng, campaign, rows = random.Random(seed_of_this_run()), Campaign("P4", kills), ROWS_A_KILL * (1 + kills)
    with streaming(folder, rows, rng) as (service, link, robot):
        for _ in campaign:
            _wait_for_a_scan(service, robot)
            time.sleep(rng.uniform(0.0, 1.0))
            if robot.ended:
                break
            kill_gateway(service, link)
        assert robot.arrives()
        cuts = link.cuts
        service.close()
    assert len(robot.noted) == rows
    found = stored(folder)
    assert [row for row, _ in found] == least_rows(rows)
    assert survey(folder / "home").problems == []
    _require_each_mark(found)
    campaign.publish(f"{len(found)} of {rows} scans sent, each once, no mark without one; {cuts} cuts")


@pytest.mark.slow  # `test_spooled_stream` kills a robot with each run
@pytest.mark.parametrize("kills", sizes("KILLED_ROBOTS", 1, 40)[1:])
@pytest.mark.timeout(7200)
def test_a_robot_that_is_killed_goes_on_with_its_marks(folder, kills):
    rng, campaign, rows = random.Random(seed_of_this_run()), Campaign("P4", kills), ROWS_A_KILL * (1 + kills)
    with streaming(folder, rows, rng) as (service, link, robot):
        for number in campaign:
            time.sleep(rng.uniform(1.0, 3.0))
            if robot.ended:
                break
            robot.kill()
            if number % 5 == 0:
                kill_gateway(service, link)
        assert robot.arrives()
        service.close()
    found = stored(folder)
    sent = [row for row, _ in found]
    assert len(set(sent)) == len(sent) and sent == sorted(sent)
    noted = {row for row, outcome in enumerate(robot.noted) if outcome == "sent"}
    # A scan on the disk whose `send` had not returned is sent, too.
    assert noted <= set(sent) and len(set(sent) - noted) <= campaign.done
    assert survey(folder / "home").problems == []
    _require_each_mark(found)
    campaign.publish(f"{len(found)} of {rows} scans sent, each once, no mark without one")


def _require_each_mark(found: list[tuple[int, float]]) -> None:
    """A scan lies within a step of each mark of the way, and the way is that of all poses."""
    way_m = way_along((thin_robot.pose(row) for row in range(found[-1][0] + 1)), MARKS).travelled_m
    assert found[-1][1] == pytest.approx(way_m, abs=0.05)
    spacing_m = MARKS.spacing_m(thin_robot.RETURNS)
    travelled = [metres for _, metres in found]
    for mark in range(int(way_m / spacing_m)):
        assert min(abs(metres - mark * spacing_m) for metres in travelled) < spacing_m / 2 + thin_robot.STEP_M
