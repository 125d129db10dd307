"""Which workers live, in an SQL database."""

from __future__ import annotations

from collections.abc import Callable

from sqlalchemy import Connection, delete, insert, select

from revisit.service.domain.records import WorkerRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.engines.sql.packed_columns import fits
from revisit.service.engines.sql.repositories import column_values


class SqlWorkerLog:
    """`WorkerLog`."""

    def __init__(self, connection: Connection, engine: DatabaseEngine, now_ms: Callable[[], int]) -> None:
        """All statements go through `connection`; `now_ms` is the time of the store."""
        self._connection = connection
        self._engine = engine
        self._now_ms = now_ms

    def beat(self, worker_id: str, model_version: str) -> None:
        """See `WorkerLog`."""
        worker = WorkerRecord(worker_id, model_version, self._now_ms())
        # No upsert, which is not standard SQL: a worker alone writes its row.
        self.forget(worker_id)
        self._connection.execute(insert(tables.workers).values(column_values(worker)))

    def alive(self, within_ms: int) -> list[WorkerRecord]:
        """See `WorkerLog`; a worker with a damaged row is none of them."""
        workers = tables.workers.c
        query = select(tables.workers).where(workers.seen_ms >= self._now_ms() - within_ms)
        query = query.order_by(workers.seen_ms.desc(), workers.worker_id)
        with self._engine.any_text(self._connection):
            rows = self._connection.execute(query).all()
        return [WorkerRecord(**row._mapping) for row in rows if fits(tables.workers.columns, row)]

    def silent(self, since_ms: int) -> list[str]:
        """See `WorkerLog`."""
        workers = tables.workers.c
        query = select(workers.worker_id).where(workers.seen_ms < self._now_ms() - since_ms)
        return list(self._connection.execute(query).scalars())

    def forget(self, worker_id: str) -> None:
        """See `WorkerLog`."""
        self._connection.execute(delete(tables.workers).where(tables.workers.c.worker_id == worker_id))
