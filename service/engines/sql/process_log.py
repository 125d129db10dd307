"""Which gateways and search processes live, in an SQL database."""

from __future__ import annotations

from sqlalchemy import Connection, delete, insert, select

from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.ports.processes import GONE_AFTER_MS


class SqlProcessLog:
    """`ProcessLog`, by the store's clock."""

    def __init__(self, connection: Connection, engine: DatabaseEngine) -> None:
        """All statements go through `connection`."""
        self._connection = connection
        self._engine = engine

    def announce(self, process: LivingProcess) -> None:
        """See `ProcessLog`."""
        rows, now_ms = tables.processes.c, self._engine.now_ms(self._connection)
        known = rows.process_id == process.process_id, rows.seen_ms >= now_ms - GONE_AFTER_MS
        came_ms = self._connection.execute(select(rows.came_ms).where(*known)).scalar()
        self.forget(process.process_id)
        row = {
            "process_id": process.process_id,
            "role": process.role.value,
            "address": process.address,
            "ready": process.ready,
            "busy": sorted(process.busy),
            "came_ms": now_ms if came_ms is None else came_ms,
            "seen_ms": now_ms,
        }
        self._connection.execute(insert(tables.processes), row)

    def alive(self, role: ProcessRole, within_ms: int) -> list[LivingProcess]:
        """See `ProcessLog`."""
        rows, since_ms = tables.processes.c, self._engine.now_ms(self._connection) - within_ms
        query = (
            select(tables.processes)
            .where(rows.role == role.value, rows.seen_ms >= since_ms)
            .order_by(rows.came_ms, rows.process_id)
        )
        return [
            LivingProcess(row.process_id, role, row.address, row.ready, frozenset(row.busy))
            for row in self._connection.execute(query)
        ]

    def forget(self, process_id: str) -> None:
        """See `ProcessLog`."""
        gone = delete(tables.processes).where(tables.processes.c.process_id == process_id)
        self._connection.execute(gone)
