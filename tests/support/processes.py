"""The real service in processes of its own, with the fake recogniser, to be killed."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from revisit.service.settings import ForTests
from tests.support.forked import ForkedProcess, serve
from tests.support.patience import PATIENCE_S
from tests.support.state import ON_POSTGRES, database_of

ROOT = Path(__file__).resolve().parents[2]


class _Logging:
    """A process of the service over `home`, without a reserve on the disk, and what it logs; `launcher` goes before."""

    launcher: tuple[str, ...] = ()
    python: tuple[str, ...] = (sys.executable,)
    folder = ROOT
    command: tuple[str, ...]

    def __init__(self, home: Path, **settings: Any) -> None:
        self._environment = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
        self._environment |= {
            "REVISIT_HOME": str(home),
            "REVISIT_HTTP_PORT": "0",
            "REVISIT_GRPC_PORT": "0",
            "REVISIT_WORKERS": "1",
            "REVISIT_RESERVE_MB": "0",
        }
        self._for_tests: dict[str, Any] = {}
        if ON_POSTGRES and "database_url" not in settings:
            settings["database_url"] = database_of(home).render_as_string(hide_password=False)
        self.set(**{"recogniser": "tests.support.fake_recogniser:load", **settings})
        self.events: list[dict[str, Any]] = []
        self.other_lines: list[str] = []
        self.start()

    def start(self) -> None:
        """Start it (again)."""
        self._process = self._begun()
        self._reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()

    def _begun(self) -> subprocess.Popen[str] | ForkedProcess:
        return subprocess.Popen(
            [*self.launcher, *self.python, "-m", "revisit.service", *self.command],
            cwd=self.folder,
            env=self._environment,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def set(self, **settings: Any) -> None:
        """Settings of the next start, those of REVISIT_FOR_TESTS by their own names; None for the default."""
        for name, value in settings.items():
            variables = self._for_tests if name in ForTests.model_fields else self._environment
            key = name if variables is self._for_tests else f"REVISIT_{name.upper()}"
            variables.pop(key, None)
            if value is not None:
                variables[key] = str(value)
        self._environment["REVISIT_FOR_TESTS"] = json.dumps(self._for_tests)

    def wait_for(self, event: str, after: int = 0, timeout_s: float = PATIENCE_S) -> dict[str, Any]:
        """The first log entry of this kind after the first `after` entries."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            for entry in self.events[after:]:
                if entry.get("event") == event:
                    return entry
            if self._process.poll() is not None:
                break
            time.sleep(0.01)
        raise AssertionError(f"no {event!r} in {self.events[-20:]}, exit status {self._process.poll()}")

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def ended(self) -> int | None:
        """The exit status, where it has ended."""
        return self._process.poll()

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def worker_pids(self) -> list[int]:
        """The workers that it has started."""
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children")
        return [int(pid) for pid in children.read_text().split()]

    def close(self) -> None:
        """End everything that is left of it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _read(self, process: subprocess.Popen[str] | ForkedProcess) -> None:
        for line in process.stderr:
            try:
                self.events.append(json.loads(line))
            except json.JSONDecodeError:
                self.other_lines.append(line)


class ServiceProcess(_Logging):
    """`python -m revisit.service serve` on free ports, with its workers."""

    command = ("serve",)

    def start(self) -> None:
        """Start it (again) and wait until it listens."""
        seen = len(self.events)
        super().start()
        listening = self.wait_for("listening", after=seen)
        host = self._environment.get("REVISIT_HOST", "127.0.0.1")
        self.url = f"http://{host}:{listening['http_port']}"
        self.grpc_target = f"{host}:{listening['grpc_port']}"

    def wait_until_it_ends(self, timeout_s: float = PATIENCE_S) -> int:
        """The exit status of a gateway that ends by itself."""
        return self._process.wait(timeout_s)

    def kill(self) -> None:
        """kill -9 the gateway; its workers are left to notice."""
        self._process.kill()
        self._process.wait()

    def terminate(self) -> tuple[int, float]:
        """SIGTERM; the exit status and how long it took, seconds."""
        started = time.monotonic()
        self._process.send_signal(signal.SIGTERM)
        status = self._process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status, time.monotonic() - started


class ForkedService(ServiceProcess):
    """A gateway like that of `python -m revisit.service serve`, from its first line on, whose imports were made before.

    Its workers are started as ever. For tests of a service that runs, not of its start or its memory.
    """

    def _begun(self) -> ForkedProcess:
        return ForkedProcess(serve, (), self.folder, self._environment)


class WorkerProcess(_Logging):
    """`python -m revisit.service worker` beside a service of the same `home`, which does not watch over it."""

    command = ("worker",)

    def start(self) -> None:
        """Start it and wait until it takes jobs."""
        super().start()
        self.wait_for("worker_ready")


class WorkersProcess(_Logging):
    """`python -m revisit.service workers`: the workers of a machine without a gateway."""

    command = ("workers",)

    def start(self) -> None:
        """Start it and wait until a worker takes jobs."""
        super().start()
        self.wait_for("worker_ready")


class SearchProcess(_Logging):
    """`python -m revisit.service search` on a free port."""

    command = ("search",)

    def start(self) -> None:
        """Start it and wait until it is asked."""
        seen = len(self.events)
        super().start()
        self.wait_for("search_ready", after=seen)


def is_running(pid: int) -> bool:
    """Whether a process lives (a zombie does not)."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def is_free(lock: Path) -> bool:
    """Whether no process holds the lock on this file, as the writers of a database do on theirs."""
    descriptor = os.open(lock, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True
