"""Group commit: writes that wait while another is synced to disk share the next transaction and its one sync."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import DatabaseError, IntegrityError

from revisit.core.errors import DataLoss, RevisitError

T = TypeVar("T")

MAX_GROUP = 64
MAX_GROUP_S = 0.005
"""A group is closed at this many members or after this long, whichever is first. It never waits for a member."""

TRIES = 3
"""Runs of a member that is disturbed by other processes each time, after which it fails."""


class Savepoints:
    """How a transaction keeps its members apart: each in a savepoint, so that an error undoes its own changes only."""

    @property
    def group_s(self) -> float:
        """A group is closed after so long at the latest."""
        return MAX_GROUP_S

    def begin(self, connection: Connection, *, first: bool) -> None:
        """Before a member's work; `first`: of its transaction, in which nothing is held yet."""
        connection.exec_driver_sql("SAVEPOINT member")

    def undo(self, connection: Connection) -> None:
        """Undo the member's work."""
        connection.exec_driver_sql("ROLLBACK TO member")

    def end(self, connection: Connection) -> None:
        """The member's work has ended, undone or not."""
        connection.exec_driver_sql("RELEASE member")

    def before_commit(self, connection: Connection, *, durable: bool) -> None:
        """The transaction is about to be committed; `durable`: at least one member must survive a power cut."""

    def disturbed(self, error: BaseException) -> bool:
        """Whether the error of a member's work comes from another process's transaction, and may not come again."""
        return False


@dataclass(frozen=True)
class _Write(Generic[T]):
    """Work to be committed."""

    work: Callable[[Connection], T]
    durable: bool
    future: Future[T] = field(default_factory=Future)


@dataclass(frozen=True)
class _Outcome:
    """The result or error of a member's work, given out after the commit of the group."""

    write: _Write[Any]
    value: Any = None
    error: BaseException | None = None

    def tell(self) -> None:
        """Complete the future."""
        if self.error is None:
            self.write.future.set_result(self.value)
        else:
            self.write.future.set_exception(self.error)


class GroupCommitter:
    """One thread that runs writes in the order of their arrival and answers each after its commit.

    Every member of a group runs in a savepoint: its error undoes its own changes only. Nobody is answered before
    the commit, because even an error may depend on the changes of an earlier member. If the commit fails, all members
    fail with it; but where a damaged row is the reason, what can be mended is, and each is run again alone. A member
    that another process disturbs is undone and begins the next group, where it holds nothing of other members while it
    waits: so two groups never wait for each other.
    """

    def __init__(
        self,
        transaction: Callable[[], AbstractContextManager[Connection]],
        savepoints: Savepoints | None = None,
        mend: Callable[[], None] = lambda: None,
    ) -> None:
        """`transaction` begins a transaction and commits it durably at the end of its block.

        `mend` replaces rows of the store's own that are damaged.
        """
        self._transaction = transaction
        self._mend = mend
        self._savepoints = savepoints or Savepoints()
        self._queue: queue.SimpleQueue[_Write[Any] | None] = queue.SimpleQueue()
        self._waiting: _Write[Any] | None = None
        self._submitting = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="writer", daemon=True)
        self._thread.start()

    def submit(self, work: Callable[[Connection], T], *, durable: bool = True) -> Future[T]:
        """Commit `work`; not `durable`: a power cut may undo it."""
        write = _Write(work, durable)
        # It cannot be cancelled: a client that disconnects does not undo its request.
        write.future.set_running_or_notify_cancel()
        with self._submitting:
            if self._closed:
                raise RuntimeError("the store is closed")
            self._queue.put(write)
        return write.future

    def close(self) -> None:
        """Commit the queued work and end the thread."""
        with self._submitting:
            if not self._closed:
                self._queue.put(None)
            self._closed = True
        self._thread.join()

    def _run(self) -> None:
        while (first := self._next()) is not None:
            self._commit(first)

    def _next(self) -> _Write[Any] | None:
        waiting, self._waiting = self._waiting, None
        return waiting or self._queue.get()

    def _commit(self, first: _Write[Any], *, alone: bool = False) -> None:
        outcomes: list[_Outcome] = []
        members: list[_Write[Any]] = []
        try:
            with self._transaction() as connection:
                for write in (first,) if alone else self._group(first):
                    members.append(write)
                    outcome = self._attempt(connection, write, first=write is first)
                    if outcome is None:
                        self._waiting = members.pop()
                        break
                    outcomes.append(outcome)
                self._savepoints.before_commit(connection, durable=any(write.durable for write in members))
        except BaseException as error:  # noqa: BLE001  # every member of the group gets the error
            if isinstance(error, DataLoss) and not alone:
                self._run_alone(members or [first])
                return
            outcomes = [_Outcome(write, error=error) for write in members or [first]]
        for outcome in outcomes:
            outcome.tell()

    def _run_alone(self, members: list[_Write[Any]]) -> None:
        """Mend what can be mended, then commit each by itself: a damaged row is in the way of one."""
        with suppress(RevisitError):
            self._mend()
        for write in members:
            self._commit(write, alone=True)

    def _group(self, first: _Write[Any]) -> Iterator[_Write[Any]]:
        """`first` and the writes queued behind it that may share its transaction."""
        yield first
        deadline = time.monotonic() + self._savepoints.group_s
        for _ in range(MAX_GROUP - 1):
            if time.monotonic() >= deadline:
                return
            try:
                write = self._queue.get_nowait()
            except queue.Empty:
                return
            if write is None:
                self._queue.put(None)
                return
            yield write

    def _attempt(self, connection: Connection, write: _Write[Any], *, first: bool) -> _Outcome | None:
        """Run one member; None where it is to begin the next group.

        Raises errors of the database itself: they end the whole transaction.
        """
        outcome, disturbed = self._run_once(connection, write, first=first)
        for _ in range(TRIES - 1 if first else 0):
            if disturbed:
                outcome, disturbed = self._run_once(connection, write, first=True)
        if disturbed and not first:
            return None
        if outcome.error is not None and _ends_all(outcome.error):
            raise outcome.error
        return outcome

    def _run_once(self, connection: Connection, write: _Write[Any], *, first: bool) -> tuple[_Outcome, bool]:
        """The outcome of one run in a savepoint, and whether it was disturbed. Raises as `_attempt`."""
        self._savepoints.begin(connection, first=first)
        disturbed = False
        try:
            outcome = _Outcome(write, value=write.work(connection))
        except BaseException as error:  # the future carries it
            disturbed = self._savepoints.disturbed(error)
            if _ends_all(error) and not disturbed:
                raise
            self._savepoints.undo(connection)
            outcome = _Outcome(write, error=error)
        self._savepoints.end(connection)
        return outcome, disturbed


def _ends_all(error: BaseException) -> bool:
    """Whether it is an error of the database itself, and not a row that it refused."""
    return isinstance(error, DatabaseError) and not isinstance(error, IntegrityError)
