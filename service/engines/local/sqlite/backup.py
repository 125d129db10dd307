"""Backups: one snapshot of the database, and every blob that its rows refer to, while the service runs.

SQLite's backup API copies the database (a copied file would lack the pages in the write-ahead log). Blobs never change
and none is deleted while a backup runs, so every blob of the copied rows is there. Each is checked against the hash in
its name. The folder gets its final name last: an interrupted backup never looks like a complete one. The manifest holds
the hash of the database, the database the hashes of the blobs,
and the manifest is signed: a change made without the key is found and not restored.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from revisit.core.errors import DataLoss
from revisit.service.engines.local.files.blobs import blob_path, nothing_deleted, read_verified
from revisit.service.engines.local.files.disk import (
    durable_write,
    make_directories,
    move_durably,
    open_folder,
    try_lock,
    write_later_synced,
)
from revisit.service.engines.local.files.secret_files import keep_secret
from revisit.service.engines.local.sqlite.backup_key import KEY_FILE, own_key, signature
from revisit.service.engines.local.sqlite.blob_rows import named_blobs
from revisit.service.engines.local.sqlite.connections import DATABASE, open_to_read
from revisit.service.engines.local.sqlite.migration import current_revision
from revisit.service.engines.local.sqlite.row_checksums import damaged_rows
from revisit.service.engines.schema import known_revisions
from revisit.service.engines.stored_blobs import Bucket
from revisit.service.ports.blobs import StoredBlob

FORMAT = 2
"""Of a signed manifest. Backups of format 1, which are not signed, are restored where that is asked for."""

UNSIGNED_FORMAT = 1
BLOBS = "blobs"
MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Manifest:
    """The contents of a backup. `lost`: the blobs that were missing or damaged when it was made, and the damaged rows.

    `signature` is that of the other fields.
    """

    format: int
    version: str
    revision: str
    created_at: str
    database_sha256: str
    blobs: int
    blob_bytes: int
    lost: tuple[str, ...]
    signature: str = ""

    def signed(self, key: bytes) -> Manifest:
        """The same with the signature of `key`."""
        fields = {name: value for name, value in asdict(self).items() if name != "signature"}
        return replace(self, signature=signature(key, fields))


class BackupRefused(DataLoss):
    """The backup is damaged, incomplete, of an unknown format or not signed by this key: nothing was restored."""


def make_backup(home: Path, out: Path, version: str, bucket: Bucket | None = None) -> Manifest:
    """Back up the data folder `home` into the new folder `out`, signed with the key of `home`; the service may run.

    Blobs come from the `bucket`, where they lie in one; those that are deleted there meanwhile count as lost.

    Raises FileExistsError where `out` is there already or another backup into it is under way, FileNotFoundError where
    there is no database, OSError.
    """
    _require_new(out)
    revision = current_revision(home / DATABASE)
    if revision is None:
        raise FileNotFoundError(f"there is no database in {home}")
    with _own_folder(out.with_name(f"{out.name}.partial")) as partial:
        # Somebody may have finished one while this one waited for its turn.
        _require_new(out)
        manifest = _fill_backup(home, partial, version, revision, bucket).signed(own_key(home))
        durable_write(partial / MANIFEST, json.dumps(asdict(manifest), indent=2).encode())
        _give_name(partial, out)
    return manifest


def restore_backup(archive: Path, home: Path, key: bytes | None, bucket: Bucket | None = None) -> Manifest:
    """Make the data folder `home`, which must be missing or empty, out of a backup; all of it or nothing.

    Blobs go into the `bucket`, where there is one; the next sweep deletes those of a restore that did not end.

    The backup must be signed with `key`, which becomes that of `home`; None takes a backup of any origin.
    Raises BackupRefused, FileExistsError, OSError.
    """
    _require_empty(home)
    manifest = read_manifest(archive)
    if key is not None and not hmac.compare_digest(manifest.signature, manifest.signed(key).signature):
        raise BackupRefused("the backup is not signed with this key: it was changed, or made with another data folder")
    _check_database(archive / DATABASE, manifest)
    with _own_folder(home.with_name(f"{home.name}.restoring")) as partial:
        _require_empty(home)
        _fill_home(archive, partial, manifest, bucket)
        if key is not None:
            keep_secret(partial / KEY_FILE, key)
        if home.exists():
            home.rmdir()
        _give_name(partial, home)
    return manifest


def _fill_backup(home: Path, partial: Path, version: str, revision: str, bucket: Bucket | None) -> Manifest:
    read = bucket.read if bucket else _reading(home / BLOBS)
    (home / BLOBS).mkdir(exist_ok=True, mode=0o700)
    with nothing_deleted(home / BLOBS):
        _copy_database(home / DATABASE, partial / DATABASE)
        with closing(open_to_read(partial / DATABASE, at_rest=True)) as rows:
            damaged = tuple(damaged_rows(rows))
            count, size_bytes, lost = _copy_blobs(rows, read, _writing(partial / BLOBS))
    return Manifest(
        format=FORMAT,
        version=version,
        revision=revision,
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        database_sha256=_sha256(partial / DATABASE),
        blobs=count,
        blob_bytes=size_bytes,
        lost=damaged + lost,
    )


def _fill_home(archive: Path, partial: Path, manifest: Manifest, bucket: Bucket | None) -> None:
    """Raises BackupRefused, and leaves nothing, where a blob is not as the manifest says."""
    write = (lambda blob, data: bucket.put(blob.tenant, blob.kind, data)) if bucket else _writing(partial / BLOBS)
    _copy_file(archive / DATABASE, partial / DATABASE)
    with closing(open_to_read(archive / DATABASE, at_rest=True)) as rows:
        count, _, lost = _copy_blobs(rows, _reading(archive / BLOBS), write)
    unexpected = sorted(set(lost) - set(manifest.lost))
    if unexpected or count != manifest.blobs:
        shutil.rmtree(partial)
        raise BackupRefused(
            f"{len(unexpected)} blobs of the backup are missing or damaged: {', '.join(unexpected[:3])}"
        )


def _require_new(out: Path) -> None:
    if out.exists():
        raise FileExistsError(f"{out} exists already: a backup goes into a new folder")


def _require_empty(home: Path) -> None:
    if home.exists() and any(home.iterdir()):
        raise FileExistsError(f"{home} is not empty: a backup is restored into a new data folder")


def read_manifest(archive: Path) -> Manifest:
    """The manifest of a backup. Raises BackupRefused."""
    try:
        data = json.loads((archive / MANIFEST).read_bytes())
        manifest = Manifest(**{**data, "lost": tuple(data["lost"])})
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BackupRefused(f"{archive} has no readable manifest") from error
    if manifest.format not in (FORMAT, UNSIGNED_FORMAT):
        raise BackupRefused(f"the backup has format {manifest.format}, this version reads {FORMAT}")
    if manifest.revision not in known_revisions():
        raise BackupRefused(
            f"the backup has schema {manifest.revision}, which this version does not know: upgrade first"
        )
    return manifest


def _check_database(database: Path, manifest: Manifest) -> None:
    if not database.is_file() or _sha256(database) != manifest.database_sha256:
        raise BackupRefused("the database of the backup is missing or damaged")
    with closing(open_to_read(database, at_rest=True)) as connection:
        (verdict,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
        damaged = sorted(set(damaged_rows(connection)) - set(manifest.lost)) if verdict == "ok" else []
    if verdict != "ok" or damaged:
        raise BackupRefused(f"the database of the backup is damaged: {', '.join(damaged[:3]) or verdict}")


def _copy_database(database: Path, target: Path) -> None:
    """Copy one snapshot in one step, which writers cannot change or restart."""
    # SQLite would make the file for everyone to read, and its journal like it.
    write_later_synced(target, b"")
    with closing(open_to_read(database)) as source, closing(sqlite3.connect(target)) as copy:
        source.backup(copy)
        # Without a write-ahead log the backup is one file.
        copy.execute("PRAGMA journal_mode=DELETE")


def _reading(folder: Path) -> Callable[[StoredBlob], bytes]:
    return lambda blob: read_verified(blob_path(folder, blob))


def _writing(folder: Path) -> Callable[[StoredBlob, bytes], None]:
    def write(blob: StoredBlob, data: bytes) -> None:
        path = blob_path(folder, blob)
        _make_private(path.parent)
        write_later_synced(path, data)

    return write


def _copy_blobs(
    rows: sqlite3.Connection, read: Callable[[StoredBlob], bytes], write: Callable[[StoredBlob, bytes], object]
) -> tuple[int, int, tuple[str, ...]]:
    """Copy the blobs of the rows; how many, how many bytes, and the addresses of missing and damaged ones."""
    count, size_bytes, lost = 0, 0, []
    for blob in named_blobs(rows):
        try:
            data = read(blob)
        except DataLoss:
            lost.append(f"{blob.tenant}/{blob.kind}/{blob.sha256}")
            continue
        write(blob, data)
        count, size_bytes = count + 1, size_bytes + len(data)
    return count, size_bytes, tuple(lost)


def _make_private(folder: Path) -> None:
    """Make the folder and the parents that it lacks, for this user only: mkdir would make the parents for everyone."""
    if not folder.is_dir():
        _make_private(folder.parent)
        folder.mkdir(mode=0o700)


def _copy_file(source: Path, target: Path) -> None:
    with source.open("rb") as file:
        write_later_synced(target, file.read())


@contextmanager
def _own_folder(folder: Path) -> Iterator[Path]:
    """The folder, empty and ours alone: leftovers of an interrupted attempt are deleted.

    Raises FileExistsError where another process fills it. The lock goes with the folder when that gets another name,
    and with this process when it ends.
    """
    make_directories(folder, folder.parent)
    descriptor = open_folder(folder)
    try:
        if not try_lock(descriptor) or not _is(folder, descriptor):
            raise FileExistsError(f"{folder} is being filled by another process")
        for left in folder.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        yield folder
    finally:
        os.close(descriptor)


def _is(folder: Path, descriptor: int) -> bool:
    """Whether the folder of this name is still the one that was opened."""
    return folder.exists() and os.path.samestat(folder.stat(), os.fstat(descriptor))


def _give_name(partial: Path, target: Path) -> None:
    """Sync all files at once, then rename."""
    os.sync()
    move_durably(partial, target)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
