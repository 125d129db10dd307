"""The unit file for systemd: what it leaves the service is little and enough, and systemd hears when it serves."""

from __future__ import annotations

import ctypes.util
import os
import re
import shutil
import socket
import subprocess
import sys
from contextlib import closing

import httpx
import pytest

from tests.support.confined import allowed_calls, values
from tests.support.patience import PATIENCE_S
from tests.support.processes import ROOT, ServiceProcess

UNIT = ROOT / "service/systemd/revisit.service"
MOST_EXPOSED = 3.0

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="no systemd-analyze here: `apt-get install systemd`"
)
needs_seccomp = pytest.mark.skipif(ctypes.util.find_library("seccomp") is None, reason="no libseccomp here")


@needs_systemd
def test_the_unit_leaves_the_service_little_of_the_machine():
    told = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(UNIT)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    exposure = float(re.search(r"exposure level for revisit.service: ([\d.]+)", told.stdout)[1])
    assert exposure <= MOST_EXPOSED, told.stdout


@needs_systemd
def test_the_unit_takes_no_call_away_that_the_service_needs():
    # Limits of workers, their niceness, their end with the gateway, memory of compiled kernels, locks of files.
    assert {"prlimit64", "setpriority", "mprotect", "prctl", "flock"} <= allowed_calls(UNIT.read_text())
    assert not {"mount", "ptrace", "bpf", "init_module", "reboot", "chroot"} & allowed_calls(UNIT.read_text())


def test_the_unit_lets_kernels_be_compiled_and_the_boot_be_known():
    unit = UNIT.read_text()
    assert not values(unit, "MemoryDenyWriteExecute") and not values(unit, "ProcSubset")


@pytest.fixture
def supervisor(tmp_path, monkeypatch):
    """What stands at the other end of NOTIFY_SOCKET."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(PATIENCE_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield heard


def test_systemd_hears_when_the_service_serves_and_when_it_stops(supervisor, tmp_path):
    assert values(UNIT.read_text(), "Type") == ["notify"]
    with closing(ServiceProcess(tmp_path / "home", workers=0)) as service:
        assert supervisor.recv(100) == b"READY=1"
        assert httpx.get(f"{service.url}/livez").status_code == 200
        assert service.terminate()[0] == 0
        assert supervisor.recv(100) == b"STOPPING=1"


class ConfinedService(ServiceProcess):
    """A service under the system calls and the address families of the unit."""

    launcher = (sys.executable, "-m", "tests.support.confined", str(UNIT))


@pytest.mark.slow
@needs_systemd
@needs_seccomp
def test_the_service_works_under_the_calls_that_the_unit_leaves_it(supervisor, tmp_path):
    method = "revisit.service.adapters.core_recogniser:load_recogniser"
    with closing(ConfinedService(tmp_path / "home", recogniser=method)) as service:
        assert supervisor.recv(100) == b"READY=1"
        example = [sys.executable, str(ROOT / "docs/examples/rest_client.py")]
        told = subprocess.run(
            example, env={**os.environ, "REVISIT_HTTP": service.url}, capture_output=True, text=True, check=True
        )
        assert (
            "maps/yard/sessions/tuesday/submaps/start is where maps/yard/sessions/monday/submaps/start" in told.stdout
        )
        assert service.terminate()[0] == 0
