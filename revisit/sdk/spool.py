"""A robot's scans on its own disk until the service has them: one SQLite file for one session.

A scan survives a power cut of the robot once `append` has returned. A scan leaves the file when the service has
acknowledged it, or has refused it for good: then its number, time, pose and reason stay as a dead letter (its cloud is
of no more use, for no later scan of the session could take its place).
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from revisit.core.errors import ErrorCode, RevisitError
from revisit.core.scan_marks import ScanMarks, Way
from revisit.sdk.clouds import Cloud
from revisit.sdk.reading import Json
from revisit.sdk.scan_choice import pose_matrix
from revisit.sdk.transport import OnDelay

DEFAULT_MAX_BYTES = 4 * 2**30
FORMAT = 2
"""The `user_version` of files that `_SCHEMA` and `_SCHEMA_2` made."""

_SCHEMA = """
BEGIN IMMEDIATE;
CREATE TABLE stream (session TEXT NOT NULL, committed_seq INTEGER, resume_token TEXT NOT NULL, last_stamp_ns INTEGER);
CREATE TABLE scans (
    id INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, pose TEXT NOT NULL, content_type TEXT NOT NULL,
    cloud BLOB NOT NULL
);
CREATE TABLE dead_letters (
    id INTEGER PRIMARY KEY, seq INTEGER NOT NULL, stamp_ns INTEGER NOT NULL, pose TEXT NOT NULL,
    cloud_bytes INTEGER NOT NULL, reason TEXT NOT NULL, message TEXT NOT NULL, refused_at_ns INTEGER NOT NULL
);
INSERT INTO stream VALUES ('', NULL, '', NULL);
PRAGMA user_version = 1;
COMMIT;
"""

_SCHEMA_2 = """
BEGIN IMMEDIATE;
ALTER TABLE stream ADD COLUMN marks TEXT NOT NULL DEFAULT '';
ALTER TABLE stream ADD COLUMN travelled_m REAL;
ALTER TABLE stream ADD COLUMN last_pose TEXT;
ALTER TABLE scans ADD COLUMN travelled_m REAL;
PRAGMA user_version = 2;
COMMIT;
"""
"""The marks of the service, and how far the session had travelled at the last scan and at each that waits."""


class SpoolFull(RevisitError):
    """The spool holds as much as it may, or its disk is full: this scan was not taken."""

    code = ErrorCode.STORAGE_FULL


class SpoolUnusable(RevisitError):
    """The spool cannot be used: another process has it, it belongs to another session, or it is damaged."""

    code = ErrorCode.STORAGE_UNCERTAIN


class SpoolDisagrees(RevisitError):
    """Spool and service do not agree about the session: scans are kept, and nothing is sent."""

    code = ErrorCode.SEQ_GAP


@dataclass(frozen=True)
class SpooledScan:
    """A scan that waits; `number` grows from scan to scan."""

    number: int
    stamp_ns: int
    pose: Json
    cloud: Cloud
    travelled_m: float | None = None


@dataclass(frozen=True)
class DeadLetter:
    """A scan that the service refused for good. `seq` is the number that its successor got instead."""

    seq: int
    stamp_ns: int
    T_odom_sensor: Json
    cloud_bytes: int
    reason: str
    message: str
    refused_at_ns: int


@dataclass(frozen=True)
class SpoolState:
    """The content of a spool. `committed_seq` is None before the service was met; `last_stamp_ns` before the first
    scan.
    """

    session: str
    committed_seq: int | None
    pending: int
    pending_bytes: int
    dead_letters: int
    last_stamp_ns: int | None


class Spool:
    """The file at `path`, made where there is none. Also the `StreamJournal` of its session; safe between threads."""

    def __init__(self, path: Path, session: str = "", max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        """For `session`; empty takes the session that the file is of. Clouds may take `max_bytes` together.

        Raises SpoolUnusable.
        """
        self._max_bytes = max_bytes
        self.on_delay: OnDelay | None = None
        self._marks: ScanMarks | None = None
        self._changed = threading.Condition(threading.RLock())
        self._lock_file = _locked(path)
        try:
            with translated():
                self._db = _opened(path)
                self._begin(session)
        except BaseException:
            os.close(self._lock_file)
            raise

    @property
    def state(self) -> SpoolState:
        """Its content now."""
        with self._changed, translated():
            session, committed_seq, _, stamp_ns = self._stream()
            (dead,) = self._db.execute("SELECT count(*) FROM dead_letters").fetchone()
            return SpoolState(session, committed_seq, self._pending, self._pending_bytes, dead, stamp_ns)

    @property
    def marks(self) -> ScanMarks | None:
        """The scans that descriptions are made of; None before the service was met."""
        return self._marks

    @property
    def way(self) -> Way | None:
        """How far the session had travelled at the last scan; None before the first."""
        with self._changed, translated():
            travelled_m, pose = self._db.execute("SELECT travelled_m, last_pose FROM stream").fetchone()
        return None if pose is None else Way(travelled_m, pose_matrix(json.loads(pose)))

    def append(
        self, cloud: Cloud, pose: Json, stamp_ns: int, wait_s: float = 0.0, travelled_m: float | None = None
    ) -> None:
        """Put a scan on the disk. Raises SpoolFull where there is no room for it within `wait_s`; SpoolUnusable."""
        with self._changed, translated():
            if not self._changed.wait_for(lambda: self._has_room(len(cloud.data)), wait_s):
                raise SpoolFull(f"the spool holds {self._pending_bytes} of {self._max_bytes} bytes")
            with self._transaction():
                self._db.execute(
                    "INSERT INTO scans (id, stamp_ns, pose, content_type, cloud, travelled_m) "
                    "VALUES (?, ?, ?, ?, ?, ?)",
                    (self._last_number + 1, stamp_ns, json.dumps(pose), cloud.content_type, cloud.data, travelled_m),
                )
                self._db.execute(
                    "UPDATE stream SET last_stamp_ns = ?, travelled_m = ?, last_pose = ?",
                    (stamp_ns, travelled_m, None if travelled_m is None else json.dumps(pose)),
                )
            self._last_number += 1
            self._count(1, len(cloud.data))

    def after(self, number: int, timeout_s: float) -> SpooledScan | None:
        """The first scan behind `number`, waited for."""
        columns = "id, stamp_ns, pose, content_type, cloud, travelled_m"
        query = f"SELECT {columns} FROM scans WHERE id > ? ORDER BY id LIMIT 1"  # noqa: S608
        with self._changed, translated():
            row = self._db.execute(query, (number,)).fetchone()
            if row is None and self._changed.wait(timeout_s):
                row = self._db.execute(query, (number,)).fetchone()
        if row is None:
            return None
        return SpooledScan(row[0], row[1], json.loads(row[2]), Cloud(row[4], row[3]), row[5])

    def dead_letters(self) -> list[DeadLetter]:
        """The scans that the service refused for good, oldest first."""
        columns = "seq, stamp_ns, pose, cloud_bytes, reason, message, refused_at_ns"
        with self._changed, translated():
            rows = self._db.execute(f"SELECT {columns} FROM dead_letters ORDER BY id").fetchall()  # noqa: S608
        return [DeadLetter(row[0], row[1], json.loads(row[2]), *row[3:]) for row in rows]

    def wait_until_empty(self, timeout_s: float) -> bool:
        """Whether every scan was answered, within `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: self._pending == 0, timeout_s)

    def wake(self) -> None:
        """End the waits that are going on."""
        with self._changed:
            self._changed.notify_all()

    def close(self) -> None:
        """Close the file; its content stays."""
        with self._changed, translated():
            self._db.close()
            os.close(self._lock_file)

    def resume_point(self) -> tuple[str, int]:
        """See `revisit.sdk.transport.StreamJournal`."""
        with self._changed, translated():
            _, committed_seq, token, _ = self._stream()
            return token, committed_seq or 0

    def opened(self, committed_seq: int, resume_token: str, marks: ScanMarks | None = None) -> None:
        """See `revisit.sdk.transport.StreamJournal`. Raises SpoolDisagrees."""
        with self._changed, translated():
            if self._stream()[1] is None:
                # The first meeting: scans that the session already has did not come from here.
                with self._transaction():
                    self._db.execute("UPDATE stream SET committed_seq = ?", (committed_seq,))
            self.committed(committed_seq)
            if resume_token:
                with self._transaction():
                    self._db.execute("UPDATE stream SET resume_token = ?", (resume_token,))
            if marks != self._marks:
                with self._transaction():
                    self._db.execute("UPDATE stream SET marks = ?", (json.dumps(asdict(marks)) if marks else "",))
                self._marks = marks

    def committed(self, committed_seq: int) -> None:
        """See `revisit.sdk.transport.StreamJournal`. Raises SpoolDisagrees."""
        with self._changed, translated():
            before = self._stream()[1] or 0
            newly = committed_seq - before
            if newly < 0:
                raise SpoolDisagrees(f"the service has {committed_seq} scans and had acknowledged {before}")
            if newly > self._pending:
                raise SpoolDisagrees(
                    f"the service has {committed_seq} scans; only {before + self._pending} came from here"
                )
            if newly:
                with self._transaction():
                    freed_bytes = self._forget_first(newly)
                    self._db.execute("UPDATE stream SET committed_seq = ?", (committed_seq,))
                self._count(-newly, -freed_bytes)

    def delayed(self, reason: str, message: str) -> None:
        """See `revisit.sdk.transport.StreamJournal`."""
        if self.on_delay is not None:
            self.on_delay(reason, message)

    def refused(self, seq: int, reason: str, message: str) -> None:
        """See `revisit.sdk.transport.StreamJournal`."""
        with self._changed, translated():
            with self._transaction():
                self._db.execute(
                    "INSERT INTO dead_letters (seq, stamp_ns, pose, cloud_bytes, reason, message, refused_at_ns) "
                    "SELECT ?, stamp_ns, pose, length(cloud), ?, ?, ? FROM scans ORDER BY id LIMIT 1",
                    (seq, reason, message, time.time_ns()),
                )
                freed_bytes = self._forget_first(1)
            self._count(-1, -freed_bytes)

    def _begin(self, session: str) -> None:
        """Bind an empty spool to `session`; count its content."""
        query = "SELECT count(*), coalesce(sum(length(cloud)), 0), coalesce(max(id), 0) FROM scans"
        self._pending, self._pending_bytes, last_number = map(int, self._db.execute(query).fetchone())
        # SQLite would begin at 1 again once all scans were sent, and a connection that is open has seen those numbers.
        self._last_number = last_number
        (marks,) = self._db.execute("SELECT marks FROM stream").fetchone()
        self._marks = _marks_of(json.loads(marks)) if marks else None
        known = self._stream()[0]
        if session in ("", known):
            return
        if self._pending:
            raise SpoolUnusable(f"the spool holds {self._pending} scans of {known}; send those first")
        with self._transaction():
            self._db.execute("UPDATE stream SET session = ?, committed_seq = NULL, resume_token = ''", (session,))
            self._db.execute("UPDATE stream SET last_stamp_ns = NULL, marks = '', travelled_m = NULL, last_pose = NULL")
            self._db.execute("DELETE FROM dead_letters")
        self._marks = None

    def _stream(self) -> tuple[str, int | None, str, int | None]:
        query = "SELECT session, committed_seq, resume_token, last_stamp_ns FROM stream"
        session, committed_seq, token, stamp_ns = self._db.execute(query).fetchone()
        return session, committed_seq, token, stamp_ns

    def _has_room(self, cloud_bytes: int) -> bool:
        return self._pending_bytes + cloud_bytes <= self._max_bytes

    def _count(self, scans: int, cloud_bytes: int) -> None:
        self._pending += scans
        self._pending_bytes += cloud_bytes
        self._changed.notify_all()

    def _forget_first(self, count: int) -> int:
        """Delete the oldest scans; the bytes of their clouds."""
        first = "SELECT id, length(cloud) AS size FROM scans ORDER BY id LIMIT ?"
        last, freed_bytes = self._db.execute(f"SELECT max(id), sum(size) FROM ({first})", (count,)).fetchone()  # noqa: S608
        self._db.execute("DELETE FROM scans WHERE id <= ?", (last,))
        return int(freed_bytes)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All of it durable at the end, or none."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        except BaseException:
            # A full disk may have rolled it back already.
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
            raise


def _marks_of(stored: dict[str, Any]) -> ScanMarks:
    """The marks of a spool, also where another release has written it."""
    known = {one.name for one in fields(ScanMarks)}
    return ScanMarks(**{name: value for name, value in stored.items() if name in known})


def _locked(path: Path) -> int:
    """A lock beside the file that the kernel frees with its process. Raises SpoolUnusable."""
    descriptor = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise SpoolUnusable(f"another process uses {path}") from error
    return descriptor


def durable_database(path: Path) -> sqlite3.Connection:
    """A file of SQLite for its owner alone, made where there is none. A statement that has ended is on the disk."""
    os.close(os.open(path, os.O_RDWR | os.O_CREAT, 0o600))
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    # An acknowledgement to the robot means on disk: anything less than FULL loses it in a power cut.
    for pragma in ("journal_mode=WAL", "synchronous=FULL"):
        connection.execute(f"PRAGMA {pragma}")
    return connection


def _opened(path: Path) -> sqlite3.Connection:
    connection = durable_database(path)
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > FORMAT:
        connection.close()
        raise SpoolUnusable(f"{path} is of format {version}, this version reads {FORMAT}")
    for step in (_SCHEMA, _SCHEMA_2)[version:]:
        connection.executescript(step)
    return connection


@contextmanager
def translated() -> Iterator[None]:
    """Errors of SQLite as SpoolFull and SpoolUnusable."""
    try:
        yield
    except sqlite3.Error as error:
        if "full" in str(error):
            raise SpoolFull("the disk is full") from error
        raise SpoolUnusable(f"the spool failed: {error}") from error
