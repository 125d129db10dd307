"""A second engine under the SQL of the product: no group commit, no log, no locks between processes, other answers."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext

from sqlalchemy import Connection, Engine, Integer, MetaData, Table, create_engine, text, update
from sqlalchemy.pool import StaticPool

from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.sql.map_numbers import numbered
from revisit.service.engines.sql.tables import metadata
from revisit.service.engines.sql.unit_of_work import SqlUnitOfWork
from revisit.service.ports.clock import Clock

HIGHEST = text("SELECT number FROM highest WHERE table_name = :name")


class PlainEngine:
    """`sql.engine.DatabaseEngine` by triggers and error codes; `ordered` tells what was asked for in commit order."""

    def __init__(self, clock: Clock) -> None:
        self.ordered: list[str] = []
        self._clock = clock

    def last_number(self, connection, table) -> int:
        """See `DatabaseEngine`."""
        return connection.execute(HIGHEST, {"name": table.name}).scalar() or 0

    def number_in_commit_order(self, connection, table) -> None:
        """See `DatabaseEngine`."""
        self.ordered.append(table.name)

    def now_ms(self, connection) -> int:
        """See `DatabaseEngine`."""
        return self._clock.monotonic_ms()

    def is_duplicate(self, error) -> bool:
        """See `DatabaseEngine`."""
        return error.orig.sqlite_errorname == "SQLITE_CONSTRAINT_UNIQUE"

    def any_text(self, connection):
        """See `DatabaseEngine`."""
        return nullcontext()

    def overwrite(self, connection, table, number, values) -> None:
        """See `DatabaseEngine`."""
        connection.execute(update(table).where(table.c.number == number).values(**values))

    def damaged_rows(self, connection, table, numbers) -> list[int]:
        """See `DatabaseEngine`."""
        return []


class PlainTransactions:
    """`Transactions`: each runs at once, in the thread that asks, alone."""

    def __init__(self, lease_ms: int, clock: Clock = SystemClock()) -> None:
        self.database, self.engine = plain_database(), PlainEngine(clock)
        self._lease_ms, self._clock = lease_ms, clock
        self._lock = threading.Lock()

    def write(self, work, *, durable: bool = True) -> Future:
        """See `Transactions`."""
        return self.read(work)

    def read(self, work) -> Future:
        """See `Transactions`."""
        future: Future = Future()
        try:
            future.set_result(self.read_here(work))
        except Exception as error:  # noqa: BLE001  # a future carries whatever the work raised
            future = Future()
            future.set_exception(error)
        return future

    def read_here(self, work):
        """See `Transactions`."""
        with self.transaction() as uow:
            return work(uow)

    @contextmanager
    def transaction(self):
        """One unit of work."""
        with self._lock, self.database.begin() as connection, numbered(connection):
            yield SqlUnitOfWork(connection, self.engine, self._lease_ms, self._clock)

    def version(self) -> int | None:
        """It does not count its commits."""
        return None

    def close(self) -> None:
        """See `Transactions`."""
        self.database.dispose()


def plain_database() -> Engine:
    """The tables as they are declared, not as the migrations make them, in the driver's own transactions."""
    database = create_engine("sqlite://", poolclass=StaticPool, connect_args={"check_same_thread": False})
    with database.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE highest (table_name TEXT PRIMARY KEY, number INTEGER)")
        declared = MetaData()
        for table in metadata.sorted_tables:
            _create(connection, table.to_metadata(declared))
    with database.connect() as connection:
        connection.exec_driver_sql("PRAGMA foreign_keys=1")
    return database


def _create(connection: Connection, table: Table) -> None:
    numbered = {"number", "seq"} & set(table.primary_key.columns.keys())
    for name in numbered:
        table.c[name].type = Integer()  # which has 64 bits here, and counts by itself
    table.dialect_options["sqlite"]["autoincrement"] = bool(numbered)
    table.create(connection)
    for number in numbered:
        connection.exec_driver_sql(
            f"CREATE TRIGGER keep_{table.name} AFTER INSERT ON {table.name} BEGIN "
            f"INSERT OR REPLACE INTO highest VALUES ('{table.name}', new.{number}); END"
        )
