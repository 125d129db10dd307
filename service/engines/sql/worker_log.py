"""Which workers live, in an SQL database."""

from __future__ import annotations

from sqlalchemy import Connection, delete, insert, select

from revisit.service.domain.records import WorkerRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import column_values
from revisit.service.ports.clock import Clock


class SqlWorkerLog:
    """`WorkerLog`."""

    def __init__(self, connection: Connection, clock: Clock) -> None:
        """All statements go through `connection`; `clock` is that of the store."""
        self._connection = connection
        self._clock = clock

    def beat(self, worker_id: str, model_version: str) -> None:
        """See `WorkerLog`."""
        now = self._clock.instant()
        worker = WorkerRecord(worker_id, model_version, now.epoch, now.ms)
        # No upsert, which is not standard SQL: a worker alone writes its row.
        self.forget(worker_id)
        self._connection.execute(insert(tables.workers).values(column_values(worker)))

    def alive(self, within_ms: int) -> list[WorkerRecord]:
        """See `WorkerLog`."""
        workers, now = tables.workers.c, self._clock.instant()
        query = select(tables.workers).where(workers.epoch == now.epoch, workers.seen_ms >= now.ms - within_ms)
        rows = self._connection.execute(query.order_by(workers.seen_ms.desc(), workers.worker_id))
        return [WorkerRecord(**row._mapping) for row in rows]

    def forget(self, worker_id: str) -> None:
        """See `WorkerLog`."""
        self._connection.execute(delete(tables.workers).where(tables.workers.c.worker_id == worker_id))
