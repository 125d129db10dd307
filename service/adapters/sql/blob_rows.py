"""Every blob that the rows of a database file name, read without the service."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import StoredBlob
from revisit.service.application.housekeeping.blob_references import NEURAL_MAP_BLOB, SIGNATURE_BLOB
from revisit.service.application.ingest.clouds import CLOUD_BLOB
from revisit.service.application.recognise.meshes import MESH_BLOB

COLUMNS = (
    ("scans", CLOUD_BLOB, "cloud_sha256"),
    ("submaps", CLOUD_BLOB, "cloud_sha256"),
    ("submaps", SIGNATURE_BLOB, "signature_sha256"),
    ("submaps", NEURAL_MAP_BLOB, "neural_map_sha256"),
    ("submaps", MESH_BLOB, "mesh_sha256"),
)
"""(table, kind of blob, column with its hash)."""

_NAMED = " UNION ".join(
    f"SELECT tenant, '{kind}', {column} FROM {table} WHERE {column} IS NOT NULL AND {column} != ''"  # noqa: S608  # ours
    for table, kind, column in COLUMNS
)


def open_to_read(database: Path, *, at_rest: bool = False) -> sqlite3.Connection:
    """A connection that cannot write; `at_rest`, where nobody else has the file open. Raises sqlite3.Error."""
    options = "mode=ro&immutable=1" if at_rest else "mode=ro"
    return sqlite3.connect(f"{database.absolute().as_uri()}?{options}", uri=True, timeout=5.0)


def named_blobs(connection: sqlite3.Connection) -> Iterator[StoredBlob]:
    """Each blob once, in the order of its address."""
    for tenant, kind, sha256 in connection.execute(f"{_NAMED} ORDER BY 1, 2, 3"):
        yield StoredBlob(TenantId(tenant), kind, sha256)
