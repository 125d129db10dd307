"""A server that does no more for a post than anyone must who promises to keep it: read, write, sync, answer.

    python -m tests.support.bare_server FOLDER ACCEPTED_PER_S

It takes so many posts a second of each caller, by the Authorization header, and refuses others with 429 at once. What
its clients wait for is the machine: the disk, the cores that they share with it, and Python.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from typing import Any

import uvicorn

from tests.support.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]


class Allowance:
    """So many posts a second, and as many at once."""

    def __init__(self, per_s: float) -> None:
        self._per_s, self._left, self._at_s = per_s, per_s, time.monotonic()

    def takes(self) -> bool:
        """Whether one more is allowed now; it is taken then."""
        now_s = time.monotonic()
        self._left = min(self._per_s, self._left + self._per_s * (now_s - self._at_s))
        self._at_s = now_s
        allowed = self._left >= 1.0
        self._left -= allowed
        return allowed


class BareServer:
    """The ASGI application."""

    def __init__(self, folder: Path, per_s: float) -> None:
        self._folder, self._numbers, self._writer = folder, count(), ThreadPoolExecutor(1)
        self._allowances = defaultdict(lambda: Allowance(per_s))

    async def __call__(self, scope: dict[str, Any], receive: Any, send: Any) -> None:
        body, more = b"", True
        while more:
            message = await receive()
            body, more = body + message.get("body", b""), message.get("more_body", False)
        status, answer = 429, b'{"reason": "RATE"}'
        if self._allowances[dict(scope["headers"]).get(b"authorization", b"")].takes():
            await asyncio.get_running_loop().run_in_executor(self._writer, self._keep, body)
            status, answer = 202, b"{}"
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(answer)).encode())]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": answer})

    def _keep(self, body: bytes) -> None:
        with (self._folder / str(next(self._numbers))).open("wb") as file:
            file.write(body)
            file.flush()
            os.fsync(file.fileno())


@contextlib.contextmanager
def bare_server(folder: Path, per_s: float) -> Iterator[str]:
    """Its address, for as long as it runs, in a process of its own."""
    folder.mkdir()
    command = [sys.executable, "-m", "tests.support.bare_server", str(folder), str(per_s)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield f"http://127.0.0.1:{int(process.stdout.readline())}"
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def main() -> None:
    """Serve on a free port, which is printed, until ended."""
    application = BareServer(Path(sys.argv[1]), float(sys.argv[2]))
    server = uvicorn.Server(uvicorn.Config(application, lifespan="off", log_level="error", port=0))
    listening = server.config.bind_socket()
    print(listening.getsockname()[1], flush=True)
    server.run(sockets=[listening])


if __name__ == "__main__":
    main()
