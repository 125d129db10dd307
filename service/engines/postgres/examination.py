"""Checks of a PostgreSQL database and of the blobs that its rows name; nothing is changed.

The server keeps checksums of its pages and compares one whenever it reads it. So a full check reads every page: each
row with all its columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sqlalchemy import Connection, ForeignKeyConstraint, Table, and_, create_engine, exists, func, select, text
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import TenantId
from revisit.service.engines.findings import Finding, examine_blobs, examine_references, examine_rows
from revisit.service.engines.postgres.connections import CONNECTING
from revisit.service.engines.sql.access_tables import audit_log
from revisit.service.engines.sql.blob_addresses import blob_addresses
from revisit.service.engines.sql.checksums import is_sound
from revisit.service.engines.sql.tables import metadata, scans, submaps
from revisit.service.features.audit.calls import judge
from revisit.service.ports.access import AuditRecord
from revisit.service.ports.blobs import CLOUD_BLOB, StoredBlob

IN_TURN = {"stream_results": True, "max_row_buffer": 1000}
"""So many rows are asked for at a time: a full check keeps no large table in memory."""

FAILURES = text("SELECT coalesce(sum(checksum_failures), 0) FROM pg_stat_database WHERE datname = current_database()")
HEIGHT = text("SELECT number FROM audit_height")


def examine(url: URL, read: Callable[[StoredBlob], bytes], *, full: bool) -> Iterator[Finding]:
    """Check a database of today's schema, and that `read` gives the blobs that its rows name: all, or a sample.

    `full`: read every row, too.
    """
    try:
        with _snapshot(url) as connection:
            yield _pages(connection)
            yield examine_references(sum(_orphans(connection)))
            if full:
                yield examine_rows(list(_damaged_rows(connection)))
            yield examine_blobs(read, list(named_blobs(connection)), full=full)
    except DBAPIError as error:
        yield Finding("database", False, str(error.orig).strip()[:200])


def newest_clouds(url: URL, count: int) -> list[StoredBlob]:
    """The clouds of the last scans and submaps; none where there is no schema yet."""
    found: list[StoredBlob] = []
    with _snapshot(url) as connection:
        for table in (scans, submaps):
            if not connection.dialect.has_table(connection, table.name):
                return []
            newest = select(table.c.tenant, table.c.cloud_sha256).order_by(table.c.number.desc()).limit(count)
            rows = connection.execute(newest)
            found += [StoredBlob(TenantId(tenant), CLOUD_BLOB, sha256) for tenant, sha256 in rows if sha256]
    return found


def named_blobs(connection: Connection) -> Iterator[StoredBlob]:
    """Each blob once, in the order of its address."""
    for tenant, kind, sha256 in connection.execute(blob_addresses(), execution_options=IN_TURN):
        yield StoredBlob(TenantId(tenant), kind, sha256)


@contextmanager
def _snapshot(url: URL) -> Iterator[Connection]:
    """A connection of its own that cannot write, and sees one moment."""
    engine = create_engine(url, connect_args=CONNECTING, isolation_level="REPEATABLE READ")
    try:
        with engine.connect() as connection:
            yield connection.execution_options(postgresql_readonly=True)
    finally:
        engine.dispose()


def _pages(connection: Connection) -> Finding:
    kept = connection.execute(text("SHOW data_checksums")).scalar_one() == "on"
    failures = int(connection.execute(FAILURES).scalar_one())
    if failures:
        return Finding("pages", False, f"the server has read {failures} damaged pages")
    without = "the server keeps no checksums of pages (pg_checksums --enable): a flipped bit is another value"
    return Finding("pages", True if kept else None, "the server has read no damaged page" if kept else without)


def _orphans(connection: Connection) -> Iterator[int]:
    """Rows of each reference whose parent is gone: a restore without constraints may leave some."""
    for table in metadata.sorted_tables:
        for key in (one for one in table.constraints if isinstance(one, ForeignKeyConstraint)):
            parent = key.referred_table.alias()
            pairs = [(element.parent, parent.c[element.column.key]) for element in key.elements]
            there = exists().where(*(own == other for own, other in pairs))
            given = and_(*(own.is_not(None) for own, _ in pairs))
            orphans = select(func.count()).select_from(table).where(given, ~there)
            yield int(connection.execute(orphans).scalar_one())


def _damaged_rows(connection: Connection) -> Iterator[str]:
    """Tables that cannot be read, descriptors that are none, and the breaks in the chain of the audit log."""
    for table in metadata.sorted_tables:
        reading = connection.begin_nested()
        try:
            for row in connection.execute(select(table), execution_options=IN_TURN):
                if table is submaps and row.descriptor is not None and not is_sound(row.descriptor, None):
                    yield f"submaps {row.number}"
        except DataLoss:
            yield from _unreadable(connection, table)
        except (DBAPIError, ValueError, TypeError) as error:
            yield f"{table.name}: {str(error).splitlines()[0][:160]}"
        finally:
            reading.rollback()
    yield from _wrong_audit(connection)


def _unreadable(connection: Connection, table: Table) -> Iterator[str]:
    """The rows of a table that are in no stored form, read one by one."""
    keys = [*table.primary_key.columns]
    for key in connection.execute(select(*keys)).all():
        try:
            connection.execute(select(table).where(*(own == value for own, value in zip(keys, key, strict=True)))).all()
        except DataLoss:
            yield f"{table.name}: row {', '.join(map(str, key))} cannot be read"


def _wrong_audit(connection: Connection) -> Iterator[str]:
    highest = int(connection.execute(HEIGHT).scalar() or 0)
    rows = connection.execute(select(audit_log).order_by(audit_log.c.number), execution_options=IN_TURN)
    fault = judge((AuditRecord(**row._mapping) for row in rows), highest).fault
    if fault is not None:
        yield f"audit_log: {fault}"
