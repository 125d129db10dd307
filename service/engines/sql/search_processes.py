"""Which search processes live, in an SQL database."""

from __future__ import annotations

from sqlalchemy import Connection, delete, insert, select

from revisit.service.domain.placement import SearchProcess
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.engine import DatabaseEngine


class SqlSearchProcesses:
    """`SearchProcessLog`, by the store's clock."""

    def __init__(self, connection: Connection, engine: DatabaseEngine) -> None:
        """All statements go through `connection`."""
        self._connection = connection
        self._engine = engine

    def announce(self, process: SearchProcess) -> None:
        """See `SearchProcessLog`."""
        self.forget(process.process_id)
        row = {
            "process_id": process.process_id,
            "address": process.address,
            "ready": process.ready,
            "busy": sorted(process.busy),
            "seen_ms": self._engine.now_ms(self._connection),
        }
        self._connection.execute(insert(tables.search_processes), row)

    def alive(self, within_ms: int) -> list[SearchProcess]:
        """See `SearchProcessLog`."""
        rows, since_ms = tables.search_processes.c, self._engine.now_ms(self._connection) - within_ms
        query = select(tables.search_processes).where(rows.seen_ms >= since_ms).order_by(rows.process_id)
        return [
            SearchProcess(row.process_id, row.address, row.ready, frozenset(row.busy))
            for row in self._connection.execute(query)
        ]

    def forget(self, process_id: str) -> None:
        """See `SearchProcessLog`."""
        gone = delete(tables.search_processes).where(tables.search_processes.c.process_id == process_id)
        self._connection.execute(gone)
