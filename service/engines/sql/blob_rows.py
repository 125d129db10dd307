"""References to blobs and their collection in an SQL database.

A row of `unreferenced_blobs` is there from the moment in which a row that named a blob went until nothing depends on it
any more. Who names the blob and who collects it change that row: the second of them waits, and sees the first.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cache
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, Update, and_, bindparam, delete, exists, insert, or_, select
from sqlalchemy import update as changed

from revisit.service.domain.errors import BlobCollected
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import BlobState
from revisit.service.engines.sql.blob_addresses import NAMED_BY_NO_ROW, REFERENCES
from revisit.service.engines.sql.tables import unreferenced_blobs
from revisit.service.ports.blobs import MOST_MS, REMEMBERED_MS, Blob, BlobCollection, StoredBlob

CUT_OFF_MS = 6 * MOST_MS
"""A collection that was begun so long ago and not ended was cut off: nobody deletes its blobs any more."""

_rows = unreferenced_blobs.c


class SqlBlobRows:
    """`BlobRows`."""

    def __init__(self, connection: Connection, now_ms: Callable[[], int]) -> None:
        """All statements go through `connection`; `now_ms` is the time of the store."""
        self._connection = connection
        self._now_ms = now_ms
        self._put_again: frozenset[int] = frozenset()

    def refer(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """See `BlobReferences`."""
        hashes = sorted({sha256 for _, sha256 in blobs})
        found = self._connection.execute(_of_hashes(), {"its_tenant": tenant, "hashes": hashes}) if hashes else ()
        if rows := [row for row in found if (row.kind, row.sha256) in set(blobs)]:
            self._take(rows)

    def put_again(self, gone: Collection[int]) -> None:
        """See `BlobReferences`."""
        self._put_again = frozenset(gone)

    def release(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """See `BlobReferences`."""
        if not blobs:
            return
        mine = and_(_rows.tenant == tenant, _rows.sha256.in_([sha256 for _, sha256 in blobs]))
        # The time counts anew: a blob that another row named until now may have been waiting for long.
        self._connection.execute(delete(unreferenced_blobs).where(mine, _rows.state == BlobState.UNREFERENCED.value))
        fresh = {"state": BlobState.UNREFERENCED.value, "since_ms": self._now_ms()}
        rows = [{"tenant": tenant, "kind": kind, "sha256": sha256, **fresh} for kind, sha256 in sorted(blobs)]
        self._connection.execute(insert(unreferenced_blobs), rows)

    def strays(self, tenant: TenantId, blobs: Collection[Blob]) -> set[Blob]:
        """See `BlobReferences`."""
        hashes = [sha256 for _, sha256 in blobs]
        known = select(_rows.kind, _rows.sha256).where(_rows.tenant == tenant, _rows.sha256.in_(hashes))
        named = {(kind, sha256) for kind, sha256 in self._connection.execute(known)}
        for kind, column in REFERENCES:
            its = column.table.c.tenant == tenant
            found = self._connection.execute(select(column).where(its, column.in_(hashes)).distinct())
            named |= {(kind, sha256) for sha256 in found.scalars()}
        return {(kind, sha256) for kind, sha256 in blobs if kind in _KINDS} - named

    def begin(self, unreferenced_ms: int, limit: int) -> BlobCollection:
        """See `BlobCollections`."""
        now_ms = self._now_ms()
        self._forget(and_(_rows.state == BlobState.GONE.value, _rows.since_ms <= now_ms - REMEMBERED_MS))
        due = {"unreferenced_ms": now_ms - unreferenced_ms, "cut_off_ms": now_ms - CUT_OFF_MS}
        numbers = list(self._connection.execute(_due(), {**due, "at_most": limit}).scalars())
        begun = self._connection.execute(_begun(), {**due, "numbers": numbers, "now_ms": now_ms})
        found = {row.number: StoredBlob(TenantId(row.tenant), row.kind, row.sha256) for row in begun}
        # What a row names again is waiting no more.
        named = [number for number in numbers if number not in found]
        self._forget(and_(_rows.number.in_(named), _rows.state == BlobState.UNREFERENCED.value))
        return BlobCollection(now_ms, found)

    def end(self, collection: BlobCollection, numbers: Collection[int]) -> None:
        """See `BlobCollections`."""
        own = and_(_rows.state == BlobState.COLLECTED.value, _rows.since_ms == collection.begun_ms)
        gone = {"state": BlobState.GONE.value, "since_ms": self._now_ms()}
        ended = changed(unreferenced_blobs).where(own, _rows.number.in_(list(numbers)))
        self._connection.execute(ended.values(gone))

    def _take(self, rows: Collection[Any]) -> None:
        """Name a blob again that was waiting. Raises BlobCollected where that is too late."""
        gone = {row.number for row in rows if row.state == BlobState.GONE}
        pending = any(row.state == BlobState.COLLECTED for row in rows)
        if pending or gone - self._put_again:
            raise BlobCollected(frozenset(gone), pending=pending)
        self._forget(_rows.number.in_([row.number for row in rows]))

    def _forget(self, which: ColumnElement[bool]) -> None:
        self._connection.execute(delete(unreferenced_blobs).where(which))


_KINDS = frozenset({*(kind for kind, _ in REFERENCES), *NAMED_BY_NO_ROW})


@cache
def _of_hashes() -> Select[Any]:
    """The rows of blobs with these `hashes`, which nobody else changes before this transaction ends."""
    its = and_(_rows.tenant == bindparam("its_tenant"), _rows.sha256.in_(bindparam("hashes", expanding=True)))
    rows = select(_rows.number, _rows.state, _rows.kind, _rows.sha256).where(its).order_by(_rows.number)
    return rows.with_for_update()


@cache
def _due() -> Select[Any]:
    """The numbers of at most `at_most` collections to begin; takes what `_is_due` does."""
    return select(_rows.number).where(_is_due()).order_by(_rows.since_ms).limit(bindparam("at_most"))


@cache
def _begun() -> Update:
    """Marks those of `numbers` as collected at `now_ms` that are still due and that no row names."""
    unnamed = and_(*(or_(_rows.kind != kind, ~_is_in(column)) for kind, column in REFERENCES))
    asked = _rows.number.in_(bindparam("numbers", expanding=True))
    mark = changed(unreferenced_blobs).where(asked, _is_due(), unnamed)
    mark = mark.values(state=BlobState.COLLECTED.value, since_ms=bindparam("now_ms"))
    return mark.returning(_rows.number, _rows.tenant, _rows.kind, _rows.sha256)


def _is_due() -> ColumnElement[bool]:
    """Whether a row is unreferenced since `unreferenced_ms`, or its collection was begun at `cut_off_ms` or before."""
    states = ((BlobState.UNREFERENCED, "unreferenced_ms"), (BlobState.COLLECTED, "cut_off_ms"))
    return or_(*(and_(_rows.state == state.value, _rows.since_ms <= bindparam(until)) for state, until in states))


def _is_in(column: Any) -> ColumnElement[bool]:
    """Whether a row names a blob in `column`."""
    return exists().where(column.table.c.tenant == _rows.tenant, column == _rows.sha256)
