"""References to blobs and their collection in memory: the reference, without anybody at the same time."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from revisit.service.domain.errors import BlobCollected
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import BlobState
from revisit.service.engines.sql.blob_addresses import NAMED_BY_NO_ROW, REFERENCES
from revisit.service.engines.sql.blob_rows import CUT_OFF_MS
from revisit.service.ports.blobs import REMEMBERED_MS, Blob, BlobCollection, StoredBlob
from revisit.service.ports.clock import Clock
from tests.support.memory.repositories import Rows

NAMES = [(kind, column.table.name, column.key) for kind, column in REFERENCES]


@dataclass(frozen=True)
class _Row:
    blob: StoredBlob
    state: BlobState
    since_ms: int


class MemoryBlobRows:
    """`BlobRows`."""

    def __init__(self, rows: Rows, tables: dict[str, Rows], clock: Clock) -> None:
        """Collections by number in `rows`; `tables` have the rows that name blobs; `clock` is the store's."""
        self._rows, self._tables, self._clock = rows, tables, clock
        self._again: frozenset[int] = frozenset()

    def refer(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """See `BlobReferences`."""
        for kind, sha256 in blobs:
            rows = {number: row for number, row in self._all() if row.blob == StoredBlob(tenant, kind, sha256)}
            gone = {number for number, row in rows.items() if row.state == BlobState.GONE}
            pending = any(row.state == BlobState.COLLECTED for row in rows.values())
            if pending or gone - self._again:
                raise BlobCollected(frozenset(gone), pending=pending)
            self._drop(rows)

    def put_again(self, gone: Collection[int]) -> None:
        """See `BlobReferences`."""
        self._again = frozenset(gone)

    def release(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """See `BlobReferences`."""
        for blob in (StoredBlob(tenant, kind, sha256) for kind, sha256 in blobs):
            waiting = {n for n, row in self._all() if row.blob == blob and row.state == BlobState.UNREFERENCED}
            self._drop(waiting)
            self._rows.last += 1
            self._rows.by_number[self._rows.last] = _Row(blob, BlobState.UNREFERENCED, self._clock.monotonic_ms())

    def strays(self, tenant: TenantId, blobs: Collection[Blob]) -> set[Blob]:
        """See `BlobReferences`."""
        kinds = {kind for kind, _, _ in NAMES} | set(NAMED_BY_NO_ROW)
        known = {(row.blob.kind, row.blob.sha256) for _, row in self._all() if row.blob.tenant == tenant}
        unknown = {blob for blob in blobs if blob[0] in kinds} - known
        return {blob for blob in unknown if not self._named(StoredBlob(tenant, *blob))}

    def begin(self, unreferenced_ms: int, limit: int) -> BlobCollection:
        """See `BlobCollections`."""
        now_ms = self._clock.monotonic_ms()
        ended = {n: row for n, row in self._all() if row.state == BlobState.GONE}
        self._drop({n for n, row in ended.items() if now_ms - row.since_ms >= REMEMBERED_MS})
        ages_ms = {BlobState.UNREFERENCED: unreferenced_ms, BlobState.COLLECTED: CUT_OFF_MS}
        old = [n for n, row in self._all() if row.state in ages_ms and row.since_ms <= now_ms - ages_ms[row.state]]
        begun = {number: self._rows.by_number[number].blob for number in old[:limit]}
        self._drop({number for number, blob in begun.items() if self._named(blob)})
        found = {number: blob for number, blob in begun.items() if number in self._rows.by_number}
        self._mark(found, BlobState.COLLECTED)
        return BlobCollection(now_ms, found)

    def end(self, collection: BlobCollection, numbers: Collection[int]) -> None:
        """See `BlobCollections`."""
        own = {n for n, row in self._all() if n in numbers and row.state == BlobState.COLLECTED}
        self._mark({n for n in own if self._rows.by_number[n].since_ms == collection.begun_ms}, BlobState.GONE)

    def _all(self) -> list[tuple[int, Any]]:
        return sorted(self._rows.by_number.items())

    def _named(self, blob: StoredBlob) -> bool:
        named = ((self._tables[table].by_number.values(), key) for kind, table, key in NAMES if kind == blob.kind)
        return any((row.tenant, getattr(row, key)) == (blob.tenant, blob.sha256) for rows, key in named for row in rows)

    def _mark(self, numbers: Collection[int], state: BlobState) -> None:
        for number in numbers:
            row = self._rows.by_number[number]
            self._rows.by_number[number] = replace(row, state=state, since_ms=self._clock.monotonic_ms())

    def _drop(self, numbers: Collection[int]) -> None:
        for number in numbers:
            del self._rows.by_number[number]
