"""Transactions on PostgreSQL: one writer thread per process with group commit, snapshots for readers.

Writers see what is committed before each statement and hold the rows that they change (SERIALIZABLE made half of the
claims fail). A member of a group that meets a row of another process does not wait for it with the rows of the other
members in its hands: it begins the next group.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from sqlalchemy import Connection, Engine
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError

from revisit.service.engines.group_commit import GroupCommitter, Savepoints
from revisit.service.engines.postgres.connections import READERS, reader_engine, writer_engine
from revisit.service.engines.postgres.engine import PostgresEngine, server_ms
from revisit.service.engines.postgres.failures import is_disturbed, translated
from revisit.service.engines.sql.map_numbers import noted, numbered
from revisit.service.engines.sql.unit_of_work import SqlUnitOfWork
from revisit.service.failpoints import failpoint
from revisit.service.ports.clock import Clock
from revisit.service.ports.transactions import UnitOfWork

T = TypeVar("T")

GROUP_S = 0.025
"""How long a group takes members: each of them is five round trips to the server, so 5 ms would be two of them."""

GLANCE_MS = 5
"""How long a later member of a group waits for a row that another process holds."""

NEXT_MEMBER = f"RELEASE SAVEPOINT member; SET LOCAL lock_timeout = {GLANCE_MS}; SAVEPOINT member"


class PostgresTransactions:
    """`Transactions` on a database that `migrate` has prepared."""

    def __init__(
        self, url: URL, *, clock: Clock, lease_ms: int = 10_000, now_ms: Callable[[Connection], int] = server_ms
    ) -> None:
        """Connects when something is read or written first; `now_ms` tells the time of the store."""
        self._writer = writer_engine(url)
        self._reader = reader_engine(url)
        self._engine = PostgresEngine(now_ms)
        self._lease_ms = lease_ms
        self._clock = clock
        self._writing = GroupCommitter(self._transaction, PostgresSavepoints())
        self._reading = ThreadPoolExecutor(READERS, thread_name_prefix="reader")

    def write(self, work: Callable[[UnitOfWork], T], *, durable: bool = True) -> Future[T]:
        """See `Transactions`."""
        return self._writing.submit(partial(self._noted, work=work), durable=durable)

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `Transactions`."""
        return self._reading.submit(self.read_here, work)

    def read_here(self, work: Callable[[UnitOfWork], T]) -> T:
        """See `Transactions`."""
        with translated(), _begun(self._reader) as connection:
            return work(self._unit_of_work(connection))

    def version(self) -> None:
        """See `Transactions`: the server counts no commits."""
        return

    def close(self) -> None:
        """See `Transactions`."""
        self._writing.close()
        self._reading.shutdown(wait=True)
        self._reader.dispose()
        self._writer.dispose()

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        with translated():
            with _begun(self._writer) as connection:
                # Counters are waited for: whoever has them waits for nothing that is held here.
                with numbered(connection, lambda: connection.exec_driver_sql("SET LOCAL lock_timeout TO DEFAULT")):
                    yield connection
                failpoint("commit.before")
            failpoint("commit.after")

    def _noted(self, connection: Connection, work: Callable[[UnitOfWork], T]) -> T:
        return noted(connection, lambda: work(self._unit_of_work(connection)))

    def _unit_of_work(self, connection: Connection) -> UnitOfWork:
        return SqlUnitOfWork(connection, self._engine, self._lease_ms, self._clock)


@contextmanager
def _begun(engine: Engine) -> Iterator[Connection]:
    """A connection in a transaction, committed at the end of the block.

    A kept connection may have died since: nothing was asked of it yet, so another one is taken.
    """
    try:
        connection = _begin(engine)
    except DBAPIError as error:
        if not error.connection_invalidated:
            raise
        connection = _begin(engine)
    with connection, connection.get_transaction():  # type: ignore[union-attr]  # it was begun
        yield connection


def _begin(engine: Engine) -> Connection:
    connection = engine.connect()
    try:
        connection.begin()
    except BaseException:
        connection.close()
        raise
    return connection


class PostgresSavepoints(Savepoints):
    """Savepoints in one round trip a member; later members only glance at rows that others hold."""

    group_s = GROUP_S

    def begin(self, connection: Connection, *, first: bool) -> None:
        """See `Savepoints`; also the end of the member before. The first one's savepoint came with the transaction."""
        if not first:
            connection.exec_driver_sql(NEXT_MEMBER)

    def end(self, connection: Connection) -> None:
        """See `Savepoints`: left to the next member, or to the commit."""

    def before_commit(self, connection: Connection, *, durable: bool) -> None:
        """See `Savepoints`."""
        if not durable:
            connection.exec_driver_sql("SET LOCAL synchronous_commit = off")

    def disturbed(self, error: BaseException) -> bool:
        """See `Savepoints`."""
        return is_disturbed(error)
