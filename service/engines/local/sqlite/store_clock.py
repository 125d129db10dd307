"""The clock of a SQLite store: milliseconds that go on from boot to boot and never run backwards.

A row of `boots` says how far the store's time is ahead of the monotonic clock of a boot of the machine; a new boot goes
on from the latest time in the store, and so does one whose row is damaged. Wall clocks have no part in it.
"""

from __future__ import annotations

import sqlite3
from typing import Any, cast

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    MetaData,
    Select,
    String,
    Table,
    delete,
    func,
    insert,
    literal,
    select,
    union_all,
)

from revisit.service.domain.states import OperationState
from revisit.service.engines.local.clock import MachineClock
from revisit.service.engines.local.sqlite.row_checksums import any_text, is_whole
from revisit.service.engines.sql.tables import jobs, processes, unreferenced_blobs, workers

boots = Table(
    "boots",
    MetaData(),
    Column("boot_id", String(64), primary_key=True),
    Column("offset_ms", BigInteger, nullable=False),
)

_OF_BOOT = f"SELECT * FROM {boots.name} WHERE boot_id = ?"  # noqa: S608  # own schema

_UNFINISHED = (OperationState.QUEUED.value, OperationState.RUNNING.value)


def _latest(column: Column[int]) -> Select[Any]:
    """Of the values that are whole numbers: a damaged row may hold any other."""
    return select(func.max(column)).where(func.typeof(column) == "integer")


_TIMES = union_all(
    select(literal(0).label("ms")),
    _latest(workers.c.seen_ms),
    _latest(processes.c.seen_ms),
    _latest(unreferenced_blobs.c.since_ms),
    _latest(jobs.c.claimed_ms).where(jobs.c.state.in_(_UNFINISHED)),
).subquery()

_LATEST = select(func.max(_TIMES.c.ms))
"""The latest time that is stored and still compared with the present."""


class StoreClock:
    """The time of a store, for one process. Boots that share it must be of one machine, one after another."""

    def __init__(self, machine: MachineClock) -> None:
        """`machine` is the clock of this boot."""
        self._machine = machine
        self._offsets_ms: dict[str, int] = {}

    def begin(self, connection: Connection) -> None:
        """At the begin of a write transaction: note a boot that the store does not know yet."""
        boot_id = self._machine.boot_id
        if boot_id in self._offsets_ms:
            return
        known = self._stored(connection, boot_id)
        if known is not None:
            self._offsets_ms[boot_id] = known
            return
        connection.execute(delete(boots).where(boots.c.boot_id == boot_id))  # a damaged one
        # Not kept in memory before it is read from a committed row.
        connection.execute(insert(boots).values(boot_id=boot_id, offset_ms=self._next(connection)))

    def now_ms(self, connection: Connection) -> int:
        """The time of the store."""
        boot_id = self._machine.boot_id
        offset_ms = self._offsets_ms.get(boot_id)
        if offset_ms is None:
            offset_ms = self._stored(connection, boot_id)
        if offset_ms is None:
            offset_ms = self._next(connection)
        return self._machine.monotonic_ms() + offset_ms

    def _stored(self, connection: Connection, boot_id: str) -> int | None:
        """The offset of a boot; None for one that is not known, or whose row is damaged."""
        with any_text(cast(sqlite3.Connection, connection.connection.driver_connection)):
            row = connection.exec_driver_sql(_OF_BOOT, (boot_id,)).one_or_none()
        known = row is not None and is_whole(boots.name, row._asdict())
        return int(row.offset_ms) if row is not None and known else None

    def _next(self, connection: Connection) -> int:
        """The offset of a boot that goes on from the latest stored time."""
        return int(connection.execute(_LATEST).scalar_one()) - self._machine.monotonic_ms()
