"""Downloading a map file over a link that breaks: received bytes are kept, and the next attempt asks for the rest."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from revisit.sdk.errors import ApiError, DataLoss, ErrorDetails
from revisit.sdk.resources import MapFile
from revisit.sdk.retry import RetryPolicy

Bytes = Callable[[str, int], Iterator[bytes]]
"""The bytes of a named file from an offset on."""

PART = ".part"
"""Behind the name of a file that is not whole yet, with a part of its hash: other versions do not go on in it."""

HASHED_BYTES = 2**20
"""That are read from the disk at a time."""


def fetch_file(file: MapFile, out: Path, read: Bytes, retry: RetryPolicy) -> None:
    """Download a map file to `out`, which is there only when it is whole.

    Goes on where it or an earlier call has stopped. Gives up after `retry.attempts` failures between which nothing
    came. Raises ApiError; DataLoss where the bytes do not have the hash of `file`, and then nothing is kept.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    part = out.with_name(f"{out.name}.{file.map_hash[:12]}{PART}")
    failures, size = 0, -1
    while (come := _size(part)) < file.size_bytes:
        failures, size = (0, come) if come > size else (failures, size)
        try:
            _append(part, read(file.name, come), file.size_bytes - come)
            if _size(part) == come:
                raise _cut_short(file)
        except ApiError as error:
            failures += 1
            if not error.retryable or failures >= retry.attempts:
                raise
            time.sleep(retry.pause_s(failures, error.retry_after_s))
    _require_hash(part, file)
    part.replace(out)


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _append(part: Path, pieces: Iterator[bytes], missing_bytes: int) -> None:
    """Append what comes; no more than a piece beyond what is missing, which then has another hash."""
    with part.open("ab") as stream:
        for piece in pieces:
            missing_bytes -= stream.write(piece)
            if missing_bytes < 0:
                return


def _require_hash(part: Path, file: MapFile) -> None:
    if not part.exists():
        part.touch()
    hashed = hashlib.sha256()
    with part.open("rb") as stream:
        while piece := stream.read(HASHED_BYTES):
            hashed.update(piece)
    found = hashed.hexdigest()
    if found != file.map_hash:
        part.unlink()
        message = f"{file.name} came with the hash {found}, not {file.map_hash}"
        raise DataLoss(ErrorDetails("DATA_LOSS", "DATA_LOSS", message))


def _cut_short(file: MapFile) -> ApiError:
    message = f"{file.name} was cut short"
    return ApiError(ErrorDetails("UNAVAILABLE", "UNREACHABLE", message, retryable=True))
