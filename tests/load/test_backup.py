"""Backups that are made one after another beside clients who post (P26): the clients wait hardly longer.

REVISIT_LOAD_S is the length of each phase in seconds (20), REVISIT_LOAD_STORED how many submaps there are (20,000).
"""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import sys
import threading

import pytest

from revisit.formats import encode_quantised
from tests.support.figures import publish
from tests.support.filled_store import fill
from tests.support.load import CALLS, OK, Sender, Tally, run_for
from tests.support.processes import ROOT, ServiceProcess
from tests.support.service_world import cloud_points

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

LOAD_S = float(os.environ.get("REVISIT_LOAD_S", "20"))
STORED = int(os.environ.get("REVISIT_LOAD_STORED", "20000"))
DIMENSION = 1024
EVERY_S = 0.2
POINTS = 20_000
CLOUD = encode_quantised(cloud_points(1, POINTS))
MOST_TIMES_SLOWER = 2.0


class Backups(threading.Thread):
    """`revisit backup`, again and again until told to stop; the exit statuses."""

    def __init__(self, home, folder, stop: threading.Event) -> None:
        super().__init__(name="backups", daemon=True)
        self._home, self._folder, self._stopped = home, folder, stop
        self.statuses: list[int] = []

    def run(self) -> None:
        for number in itertools.count():
            if self._stopped.is_set():
                return
            archive = self._folder / f"backup{number}"
            command = [sys.executable, "-m", "revisit.cli", "backup", str(archive), "--home", str(self._home)]
            self.statuses.append(subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False).returncode)
            shutil.rmtree(archive)


@pytest.fixture
def service(tmp_path):
    fill(tmp_path / "home", STORED, DIMENSION)
    running = ServiceProcess(tmp_path / "home", workers=1)
    yield running
    running.close()


def phase(service, transport, name, *beside):
    """What a client saw that posts a cloud every 0.2 s."""
    tally, stop = Tally(), threading.Event()
    others = [make(stop) for make in beside]
    run_for(LOAD_S, stop, Sender(name, CALLS[transport](service, CLOUD), tally, EVERY_S, stop), *others)
    return tally, others


@pytest.mark.parametrize("transport", CALLS)
def test_clients_hardly_notice_a_backup(service, tmp_path, transport):
    calm, _ = phase(service, transport, "calm")
    beside, (backups,) = phase(service, transport, "beside", lambda stop: Backups(tmp_path / "home", tmp_path, stop))
    times = {name: [tally.quantile_ms(share, OK) for share in (0.5, 0.99)] for name, tally in
             (("calm_p50_p99_ms", calm), ("beside_p50_p99_ms", beside))}  # fmt: skip
    publish("backup", promise="P26", transport=transport, stored=STORED, backups=len(backups.statuses), **times)
    assert (calm.others(OK), beside.others(OK), set(backups.statuses)) == ({}, {}, {0})
    for calm_ms, beside_ms in zip(*times.values(), strict=True):
        assert beside_ms <= MOST_TIMES_SLOWER * calm_ms
