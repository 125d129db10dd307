"""Which workers live, in an SQL database."""

from __future__ import annotations

from sqlalchemy import Connection, delete, insert, select

from revisit.service.domain.records import WorkerRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import column_values


class SqlWorkerLog:
    """`WorkerLog`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def beat(self, worker: WorkerRecord) -> None:
        """See `WorkerLog`."""
        # No upsert, which is not standard SQL: a worker alone writes its row.
        self.forget(worker.worker_id)
        self._connection.execute(insert(tables.workers).values(column_values(worker)))

    def alive(self, epoch: str, since_ms: int) -> list[WorkerRecord]:
        """See `WorkerLog`."""
        workers = tables.workers.c
        query = select(tables.workers).where(workers.epoch == epoch, workers.seen_ms >= since_ms)
        rows = self._connection.execute(query.order_by(workers.seen_ms.desc(), workers.worker_id))
        return [WorkerRecord(**row._mapping) for row in rows]

    def forget(self, worker_id: str) -> None:
        """See `WorkerLog`."""
        self._connection.execute(delete(tables.workers).where(tables.workers.c.worker_id == worker_id))
