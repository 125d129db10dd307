"""The demo's service: started on free ports with its data in a temporary folder, stopped at the end."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

START_S = 90.0


@dataclass(frozen=True)
class Addresses:
    """Where the demo's service listens."""

    http: str
    grpc: str


@contextmanager
def running_service(home: Path, settings: Mapping[str, str] | None = None) -> Iterator[Addresses]:
    """`python -m revisit.service serve` on free ports with its data in `home`, stopped on leaving.

    `settings` are further variables of its environment. Raises RuntimeError with the end of its log where it does not
    start.
    """
    from revisit.service import python_subprocess

    environment = {
        **python_subprocess.environment(),
        "REVISIT_HOME": str(home / "data"), "REVISIT_HTTP_PORT": "0", "REVISIT_GRPC_PORT": "0",
        "REVISIT_HOST": "127.0.0.1", "REVISIT_WORKERS": str(os.cpu_count() or 1), "REVISIT_LOG_LEVEL": "INFO",
        **(settings or {}),
    }  # fmt: skip
    log = home / "service.log"
    with log.open("wb") as stream:
        command = python_subprocess.command("-m", "revisit.service", "serve")
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=subprocess.STDOUT)
    try:
        yield _when_listening(process, log)
    finally:
        _stop(process)


def _when_listening(process: subprocess.Popen[bytes], log: Path) -> Addresses:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        for line in log.read_text(errors="replace").splitlines():
            if '"listening"' in line:
                event = json.loads(line)
                return Addresses(f"http://127.0.0.1:{event['http_port']}", f"127.0.0.1:{event['grpc_port']}")
        time.sleep(0.1)
    raise RuntimeError("the service did not start:\n" + log.read_text(errors="replace")[-3000:])


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=30.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
