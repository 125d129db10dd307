"""Checks of stored data that all engines share: what a check found, the bucket, and the blobs that rows name."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from revisit.core.errors import RevisitError
from revisit.service.engines.stored_blobs import BlobStoreUnusable, Bucket
from revisit.service.ports.blobs import StoredBlob

SAMPLE = 200
"""How many blobs a check reads that is not asked to read all."""


@dataclass(frozen=True)
class Finding:
    """The result of one check. `ok` is None where the check does not apply."""

    check: str
    ok: bool | None
    detail: str


def examine_bucket(bucket: Bucket | None) -> Iterator[Finding]:
    """Check the bucket of the blobs, where they lie in one: an object is stored, read, listed and deleted."""
    if bucket is None:
        return
    try:
        keeps_versions = bucket.try_out()
    except BlobStoreUnusable as error:
        yield Finding("bucket", False, str(error))
        return
    if keeps_versions:
        detail = "kept: what is deleted stays until a lifecycle rule deletes noncurrent versions; is there one?"
        yield Finding("versions of objects", None, detail)
    yield Finding("bucket", True, f"{bucket.url} stores, gives back, lists and deletes")


def examine_blobs(read: Callable[[StoredBlob], bytes], named: Sequence[StoredBlob], *, full: bool) -> Finding:
    """Check that blobs which rows name can be read: all, or a sample."""
    chosen = named if full else random.sample(named, min(SAMPLE, len(named)))
    bad = [problem for blob in chosen if (problem := _problem(read, blob))]
    return Finding("blobs", not bad, f"{len(chosen)} of {len(named)} read, {len(bad)} missing or damaged{some_of(bad)}")


def examine_rows(wrong: Sequence[str]) -> Finding:
    """The finding about rows: those that are `wrong`."""
    return Finding("rows", not wrong, f"{len(wrong)} are not what was written{some_of(wrong)}")


def examine_references(broken: int) -> Finding:
    """The finding about rows that refer to others."""
    return Finding("references", not broken, f"{broken} rows whose parent is gone")


def some_of(examples: Sequence[str]) -> str:
    """The first of them, to be written behind their number."""
    return f": {'; '.join(examples[:3])}" if examples else ""


def _problem(read: Callable[[StoredBlob], bytes], blob: StoredBlob) -> str:
    try:
        read(blob)
    except RevisitError as error:
        return error.message
    return ""
