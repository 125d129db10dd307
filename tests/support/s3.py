"""Two S3 servers on this machine, since each is lenient where the other is not.

moto takes any secret and any date; nanio ignores conditions, and survives a kill. Both are started once a test process.
"""

from __future__ import annotations

import atexit
import functools
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from itertools import count
from pathlib import Path
from typing import Protocol

import httpx

from tests.support.patience import PATIENCE_S

KEY, SECRET = "robots", "a-secret-of-tests"
ANYBODY = {"Authorization": f"AWS4-HMAC-SHA256 Credential={KEY}/20260101/us-east-1/s3/aws4_request"}
"""What moto needs to know an account by."""

_names = count(1)


class S3Server(Protocol):
    """A server; `address` is its host:port."""

    address: str

    def new_bucket(self, *, versions: bool = False) -> str:
        """The name of an empty bucket, which keeps versions or does not."""
        ...


def variables(address: str, secret: str = SECRET) -> dict[str, str]:
    """The AWS_* variables of a client of a server, or of a link to it."""
    return {
        "AWS_ENDPOINT_URL": address if address.startswith("http") else f"http://{address}",
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": KEY,
        "AWS_SECRET_ACCESS_KEY": secret,
    }


class Moto:
    """moto's threaded server, in this process."""

    def __init__(self) -> None:
        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        from moto.server import ThreadedMotoServer

        server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        server.start()
        atexit.register(server.stop)
        self.address = "{}:{}".format(*server.get_host_and_port())

    def new_bucket(self, *, versions: bool = False) -> str:
        """See `S3Server`."""
        bucket = f"{self.address}/bucket-{next(_names)}"
        httpx.put(f"http://{bucket}", headers=ANYBODY).raise_for_status()
        if versions:
            body = "<VersioningConfiguration><Status>Enabled</Status></VersioningConfiguration>"
            httpx.put(f"http://{bucket}?versioning", content=body, headers=ANYBODY).raise_for_status()
        return bucket.rpartition("/")[2]


class Nanio:
    """nanio in a process of its own, to be killed and started again; buckets are folders."""

    def __init__(self, folder: Path) -> None:
        """Objects are stored below `folder`."""
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"127.0.0.1:{self._port}"
        self.start()

    def start(self) -> None:
        """Start it, again after it was killed, and wait until it answers.

        It would refuse an object for good whose half-written file it finds.
        """
        for left in self.folder.rglob("*.tmp"):
            left.unlink()
        quiet = ("--no-access-log", "--log-level", "error")
        where = ("--data-dir", str(self.folder), "--host", "127.0.0.1", "--port", str(self._port))
        environment = {**os.environ, "NANIO_ACCESS_KEY": KEY, "NANIO_SECRET_KEY": SECRET}
        self._process = subprocess.Popen([sys.executable, "-m", "nanio", "serve", *where, *quiet], env=environment)
        deadline = time.monotonic() + PATIENCE_S
        while not self._answers():
            assert self._process.poll() is None and time.monotonic() < deadline, "nanio did not start"
            time.sleep(0.02)

    def kill(self) -> None:
        """End it as a power cut would."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(PATIENCE_S)

    def new_bucket(self, *, versions: bool = False) -> str:
        """See `S3Server`; it has none that keep versions."""
        assert not versions
        bucket = f"bucket-{next(_names)}"
        (self.folder / bucket).mkdir()
        return bucket

    def _answers(self) -> bool:
        try:
            httpx.get(f"http://{self.address}/")
        except httpx.TransportError:
            return False
        return True


@functools.cache
def moto() -> Moto:
    """The moto of this test process."""
    return Moto()


@functools.cache
def nanio() -> Nanio:
    """The nanio of this test process."""
    folder = Path(tempfile.mkdtemp(prefix="revisit-s3-"))
    server = Nanio(folder)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    atexit.register(server.kill)
    return server
