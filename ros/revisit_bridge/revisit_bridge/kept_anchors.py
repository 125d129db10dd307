"""Anchors on the robot's disk until the service has them: one SQLite file for one session, beside its spool."""

from __future__ import annotations

import json
import logging
import sqlite3
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from revisit.core.errors import RevisitError
from revisit.sdk.anchors import ANCHORS_AT_ONCE, NewAnchor
from revisit.sdk.errors import ApiError
from revisit.sdk.spool import durable_database, translated

log = logging.getLogger("revisit_bridge")

MOST_KEPT = 50_000
"""As many as the service takes of a session."""

REFUSED = frozenset({"INVALID_ARGUMENT", "ALREADY_EXISTS"})
"""Codes of refusals of an anchor itself. After others it is sent again."""

_SCHEMA = "CREATE TABLE IF NOT EXISTS anchors (id INTEGER PRIMARY KEY, anchor TEXT NOT NULL)"


class KeptAnchors:
    """The file is made with the first anchor. Safe between threads."""

    def __init__(self, path: Path) -> None:
        """Raises SpoolUnusable."""
        self._path, self._lock = path, threading.Lock()
        self._db: sqlite3.Connection | None = None
        self._waiting = 0
        if path.is_file():
            with translated():
                (self._waiting,) = self._opened().execute("SELECT count(*) FROM anchors").fetchone()

    @property
    def waiting(self) -> int:
        """How many there are."""
        return self._waiting

    def keep(self, anchor: NewAnchor) -> None:
        """Put an anchor on the disk. Raises RevisitError."""
        if self._waiting >= MOST_KEPT:
            raise RevisitError(f"{MOST_KEPT} anchors of the session wait for the service, as many as it takes")
        with self._lock, translated():
            self._opened().execute("INSERT INTO anchors (anchor) VALUES (?)", (json.dumps(anchor.message()),))
            self._waiting += 1

    def first(self, count: int) -> list[tuple[int, NewAnchor]]:
        """The oldest ones with their numbers. Raises SpoolUnusable."""
        if not self._waiting:
            return []
        with self._lock, translated():
            query = "SELECT id, anchor FROM anchors ORDER BY id LIMIT ?"
            rows = self._opened().execute(query, (count,)).fetchall()
        return [(number, NewAnchor.of_json(json.loads(anchor))) for number, anchor in rows]

    def forget(self, numbers: Sequence[int]) -> None:
        """Remove some, for the service has answered them. Raises SpoolUnusable."""
        marks = ",".join("?" * len(numbers))
        with self._lock, translated():
            self._opened().execute(f"DELETE FROM anchors WHERE id IN ({marks})", numbers)  # noqa: S608
            self._waiting -= len(numbers)

    def close(self) -> None:
        """Close the file; its content stays."""
        with self._lock:
            if self._db is not None:
                self._db.close()

    def _opened(self) -> sqlite3.Connection:
        if self._db is None:
            self._db = durable_database(self._path)
            self._db.execute(_SCHEMA)
        return self._db


@dataclass
class AnchorPosting:
    """Posts kept anchors by way of `post`, which raises ApiError. Counts those `stored`, and `refused` for good."""

    post: Callable[[str, Sequence[NewAnchor]], None]
    stored: int = 0
    refused: int = 0

    def empty(self, session: str, kept: KeptAnchors) -> None:
        """Post all of them. Raises ApiError, after which the rest is kept."""
        while some := kept.first(ANCHORS_AT_ONCE):
            try:
                self.post(session, [anchor for _, anchor in some])
            except ApiError as error:
                if error.code not in REFUSED:
                    raise
                self._post_each(session, kept, some)
            else:
                kept.forget([number for number, _ in some])
                self.stored += len(some)

    def _post_each(self, session: str, kept: KeptAnchors, some: Sequence[tuple[int, NewAnchor]]) -> None:
        """One after the other: a call stores all of them or none."""
        for number, anchor in some:
            try:
                self.post(session, [anchor])
            except ApiError as error:
                if error.code not in REFUSED:
                    raise
                log.warning("anchor %s of %s was refused: %s", anchor.anchor_id, session, error.message)
                self.refused += 1
            else:
                self.stored += 1
            kept.forget([number])
