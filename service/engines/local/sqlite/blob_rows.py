"""The blobs that the rows of a database file refer to, read without the service."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from functools import cache

from sqlalchemy.dialects import sqlite

from revisit.service.domain.identity import TenantId
from revisit.service.engines.sql.blob_addresses import blob_addresses
from revisit.service.ports.blobs import CLOUD_BLOB, StoredBlob


def named_blobs(connection: sqlite3.Connection) -> Iterator[StoredBlob]:
    """Each blob once, in the order of its address."""
    for tenant, kind, sha256 in connection.execute(_statement()):
        yield StoredBlob(TenantId(tenant), kind, sha256)


def newest_clouds(connection: sqlite3.Connection, count: int) -> list[StoredBlob]:
    """The clouds of the last scans and submaps."""
    newest = (
        connection.execute(f"SELECT tenant, cloud_sha256 FROM {table} ORDER BY number DESC LIMIT ?", (count,))  # noqa: S608
        for table in ("scans", "submaps")
    )
    return [StoredBlob(TenantId(tenant), CLOUD_BLOB, sha256) for rows in newest for tenant, sha256 in rows if sha256]


@cache
def _statement() -> str:
    return str(blob_addresses().compile(dialect=sqlite.dialect(), compile_kwargs={"literal_binds": True}))
