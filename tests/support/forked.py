"""Processes that begin as a copy of one that has imported everything: what a start imports takes a second or more.

They are children of multiprocessing's fork server, which is started once in a test process and runs no thread.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.forkserver
import multiprocessing.reduction
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

processes = multiprocessing.get_context("forkserver")
processes.set_forkserver_preload(["tests.support.imported"])
"""Of all tests that begin processes so: the server is one, and takes its list when it starts."""


def end_server() -> None:
    """End the server of this process and wait for it, so that its work and that of all that it began is counted."""
    multiprocessing.forkserver._forkserver._stop()  # type: ignore[attr-defined]  # there is no public way


class ForkedProcess:
    """`target` with `arguments` in a session of its own, with the methods of `subprocess.Popen` that tests use."""

    def __init__(
        self, target: Callable[..., int], arguments: tuple[Any, ...], folder: Path, environment: Mapping[str, str]
    ) -> None:
        """`folder` is its working directory. What it writes to standard error is read from `stderr`."""
        reading, writing = os.pipe()
        self.stderr: IO[str] = os.fdopen(reading, "r")
        handed = multiprocessing.reduction.DupFd(writing)
        self._process = processes.Process(target=_run, args=(target, arguments, str(folder), dict(environment), handed))
        self._process.start()
        os.close(writing)
        assert self._process.pid is not None
        self.pid: int = self._process.pid

    def poll(self) -> int | None:
        """The exit status, where it has ended."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """The exit status of a process that ends. Raises subprocess.TimeoutExpired."""
        self._process.join(timeout)
        status = self._process.exitcode
        if status is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0.0)
        return status

    def send_signal(self, number: int) -> None:
        """Send it a signal, where it has not ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()


def _run(
    target: Callable[..., int], arguments: tuple[Any, ...], folder: str, environment: dict[str, str], handed: Any
) -> None:
    os.setsid()
    os.chdir(folder)
    descriptor = handed.detach()
    os.dup2(descriptor, 2)
    os.close(descriptor)
    os.environ.clear()
    os.environ.update(environment)
    time.tzset()
    sys.exit(target(*arguments))


def serve() -> int:
    """`python -m revisit.service serve`."""
    from revisit.service.__main__ import main

    return main(["serve"])
