"""Checks of a data folder: the database, and whether every blob that a row refers to is there and undamaged."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from revisit.core.errors import DataLoss
from revisit.service.engines.findings import Finding, examine_blobs, examine_bucket, examine_references, examine_rows
from revisit.service.engines.local.files.blobs import FileBlobStore, blob_path, read_verified
from revisit.service.engines.local.files.filesystem import MOUNTS, RemoteFileSystem, filesystem_type, require_local
from revisit.service.engines.local.sqlite.blob_rows import named_blobs
from revisit.service.engines.local.sqlite.connections import DATABASE, open_to_read, write_ahead_log
from revisit.service.engines.local.sqlite.migration import current_revision
from revisit.service.engines.local.sqlite.row_checksums import damaged_rows
from revisit.service.engines.schema import NEWEST_REVISION, known_revisions
from revisit.service.engines.stored_blobs import QUARANTINE, BlobDamaged, Bucket
from revisit.service.features.upkeep.calls import LOG_ALARM_BYTES
from revisit.service.ports.blobs import StoredBlob

FIXED_SQLITE = (3, 51, 3)
BACKPORTS = ((3, 44, 6), (3, 50, 7))
"""The first SQLite versions in which two connections cannot damage the write-ahead log (the WAL-reset fault)."""


def examine(home: Path, *, full: bool, bucket: Bucket | None = None) -> list[Finding]:
    """Check a data folder, and the bucket of its blobs where they lie in one, whether or not the service runs.

    Changes nothing. `full`: read every blob and row.
    """
    database = home / DATABASE
    findings = [_sqlite_library(), _file_system(home), *examine_bucket(bucket)]
    if findings[-1].ok is False:
        return findings
    if not database.exists():
        return [*findings, Finding("database", None, f"{database} does not exist yet")]
    try:
        with closing(open_to_read(database)) as rows:
            findings += [_schema(database), _pages(rows), _references(rows), _wal(database)]
            findings += [examine_rows(list(damaged_rows(rows)))] if full else []
            findings.append(examine_blobs(blob_reader(home, bucket), list(named_blobs(rows)), full=full))
    except (sqlite3.Error, UnicodeError) as error:  # SQLite's messages hold names, damaged or not
        findings.append(Finding("database", False, f"{database}: {error}"))
    return [*findings, quarantine(home, bucket)]


@dataclass(frozen=True)
class Scrubbed:
    """The result of a scrub: blobs read, blobs moved to quarantine, blobs missing;
    SQLite's integrity verdict, and the damaged rows.
    """

    checked: int
    damaged: tuple[str, ...]
    missing: tuple[str, ...]
    database: str
    rows: tuple[str, ...]


def scrub(home: Path, bucket: Bucket | None = None) -> Scrubbed:
    """Read every blob that a row refers to and every page of the database; the service may run.

    A damaged blob is put into quarantine: requests for it get DATA_LOSS until the same content is posted again.
    Raises OSError, sqlite3.Error, StorageUncertain.
    """
    store = bucket or FileBlobStore(home / "blobs")
    damaged: list[str] = []
    missing: list[str] = []
    with closing(open_to_read(home / DATABASE)) as rows:
        (verdict,) = rows.execute("PRAGMA integrity_check(1)").fetchone()
        # Where a page is wrong, rows cannot be read.
        wrong = tuple(damaged_rows(rows)) if verdict == "ok" else ()
        blobs = list(named_blobs(rows))
    for blob in blobs:
        try:
            store.get(blob.tenant, blob.kind, blob.sha256)
        except DataLoss as error:
            (damaged if isinstance(error, BlobDamaged) else missing).append(f"{blob.tenant}/{blob.kind}/{blob.sha256}")
    return Scrubbed(len(blobs), tuple(damaged), tuple(missing), str(verdict), wrong)


def quarantine(home: Path, bucket: Bucket | None) -> Finding:
    """Check that no damaged blob lies aside."""
    folder = home / "blobs"
    place = f"{bucket.url}/{QUARANTINE}" if bucket else str(folder / QUARANTINE)
    stores = [bucket] if bucket else [FileBlobStore(folder)] if folder.is_dir() else []
    aside = sum(store.quarantined() for store in stores)
    return Finding("quarantine", aside == 0, f"{aside} damaged blobs lie in {place}" if aside else "empty")


def blob_reader(home: Path, bucket: Bucket | None) -> Callable[[StoredBlob], bytes]:
    """Reads blobs where they lie, and leaves damaged ones alone."""
    return bucket.read if bucket else lambda blob: read_verified(blob_path(home / "blobs", blob))


def _sqlite_library() -> Finding:
    version = sqlite3.sqlite_version_info
    fixed = version >= FIXED_SQLITE or any(version[:2] == known[:2] and version >= known for known in BACKPORTS)
    note = "" if fixed else ", has the WAL-reset fault; the service never writes or checkpoints from two connections"
    return Finding("SQLite", True, f"{sqlite3.sqlite_version}{note}")


def _file_system(home: Path) -> Finding:
    try:
        require_local(home)
    except RemoteFileSystem as error:
        return Finding("file system", False, str(error))
    kind = filesystem_type(home.resolve(), MOUNTS.read_text()) if MOUNTS.exists() else "unknown"
    return Finding("file system", True, kind)


def _schema(database: Path) -> Finding:
    revision = current_revision(database)
    if revision == NEWEST_REVISION:
        return Finding("schema", True, f"{revision}, the newest")
    if revision in known_revisions():
        return Finding("schema", True, f"{revision}; the next start brings it to {NEWEST_REVISION}")
    made = "an older" if str(revision) < NEWEST_REVISION else "a newer"
    return Finding("schema", False, f"{revision}, which this version does not know: {made} one made it")


def _pages(rows: sqlite3.Connection) -> Finding:
    (verdict,) = rows.execute("PRAGMA integrity_check(1)").fetchone()
    return Finding("database", verdict == "ok", f"integrity {verdict}")


def _references(rows: sqlite3.Connection) -> Finding:
    broken = rows.execute("PRAGMA foreign_key_check").fetchall()
    return examine_references(len(broken))


def _wal(database: Path) -> Finding:
    wal = write_ahead_log(database)
    size_bytes = wal.stat().st_size if wal.exists() else 0
    return Finding("WAL", size_bytes <= LOG_ALARM_BYTES, f"{size_bytes / 2**20:.1f} MiB")
