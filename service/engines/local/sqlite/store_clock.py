"""The clock of a SQLite store: milliseconds that go on from boot to boot and never run backwards.

A row of `boots` says how far the store's time is ahead of the monotonic clock of a boot of the machine; a new boot goes
on from the latest time in the store. Wall clocks have no part in it.
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, Connection, MetaData, String, Table, func, insert, literal, select, union_all

from revisit.service.domain.states import OperationState
from revisit.service.engines.local.clock import MachineClock
from revisit.service.engines.sql.tables import jobs, processes, unreferenced_blobs, workers

boots = Table(
    "boots",
    MetaData(),
    Column("boot_id", String(64), primary_key=True),
    Column("offset_ms", BigInteger, nullable=False),
)

_OFFSET = select(boots.c.offset_ms)

_UNFINISHED = (OperationState.QUEUED.value, OperationState.RUNNING.value)

_TIMES = union_all(
    select(literal(0).label("ms")),
    select(func.max(workers.c.seen_ms)),
    select(func.max(processes.c.seen_ms)),
    select(func.max(unreferenced_blobs.c.since_ms)),
    select(func.max(jobs.c.claimed_ms)).where(jobs.c.state.in_(_UNFINISHED)),
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
        offset_ms: int | None = connection.execute(_OFFSET.where(boots.c.boot_id == boot_id)).scalar()
        return offset_ms

    def _next(self, connection: Connection) -> int:
        """The offset of a boot that goes on from the latest stored time."""
        return int(connection.execute(_LATEST).scalar_one()) - self._machine.monotonic_ms()
