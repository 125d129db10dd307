"""Numbers of a map, in the order of the commits: of its changes, its events and its submaps.

A map has one row of counters. What gets a number is noted until the end of the transaction; then the counters are
raised, of one map after the other in the order of their keys, as the last that is locked. So whoever has seen a number
never misses a lower one, and two transactions never wait for each other (docs/decisions/0325).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from sqlalchemy import Connection, Update, bindparam, insert, update
from sqlalchemy.sql.dml import ReturningUpdate

from revisit.service.domain.identity import TenantId
from revisit.service.engines.sql import tables

T = TypeVar("T")

_NOTED = "noted numbers"

_MapKey = tuple[TenantId, str]


@dataclass(frozen=True)
class _Noted:
    """Rows of one map without their number: changes and events to add, and the numbers of submaps that were added.

    With each change: whether its submap enters by it. With each event: whether its loop is accepted by it.
    """

    changes: list[tuple[dict[str, Any], bool]] = field(default_factory=list)
    events: list[tuple[dict[str, Any], bool]] = field(default_factory=list)
    submaps: list[int] = field(default_factory=list)


def note_changes(
    connection: Connection, tenant: TenantId, map_id: str, rows: Sequence[dict[str, Any]], *, enter: bool
) -> None:
    """Add these rows of `index_changes` at the end of the transaction; submaps that `enter` are told the numbers."""
    _notes(connection).extend(((tenant, map_id), "changes", (row, enter)) for row in rows)


def note_event(
    connection: Connection, tenant: TenantId, map_id: str, row: dict[str, Any], *, accepts: bool = False
) -> None:
    """Add this row of `events` at the end of the transaction; a loop that it `accepts` is told the number."""
    _notes(connection).append(((tenant, map_id), "events", (row, accepts)))


def note_submap(connection: Connection, tenant: TenantId, map_id: str, number: int) -> None:
    """Give the submap with this number of a row its `seq` at the end of the transaction."""
    _notes(connection).append(((tenant, map_id), "submaps", number))


def noted(connection: Connection, work: Callable[[], T]) -> T:
    """The result of a member's work; where it fails, what it has noted is forgotten."""
    notes = _notes(connection)
    before = len(notes)
    try:
        return work()
    except BaseException:
        del notes[before:]
        raise


@contextmanager
def numbered(connection: Connection, before: Callable[[], object] = lambda: None) -> Iterator[None]:
    """A transaction: what is noted in the block is numbered at its end, and `before` called before that."""
    notes = _notes(connection)
    notes.clear()
    yield
    if notes:
        before()
        _number(connection, notes)


def _notes(connection: Connection) -> list[tuple[_MapKey, str, Any]]:
    notes: list[tuple[_MapKey, str, Any]] = connection.info.setdefault(_NOTED, [])
    return notes


def _number(connection: Connection, notes: list[tuple[_MapKey, str, Any]]) -> None:
    of_map: dict[_MapKey, _Noted] = {}
    for key, kind, row in notes:
        getattr(of_map.setdefault(key, _Noted()), kind).append(row)
    changes: list[dict[str, Any]] = []
    events: list[dict[str, Any]] = []
    submaps: list[dict[str, Any]] = []
    entered: list[dict[str, Any]] = []
    accepted: list[dict[str, Any]] = []
    for (tenant, map_id), its in sorted(of_map.items()):
        more = {"changes": len(its.changes), "events": len(its.events), "submaps": len(its.submaps)}
        asked = {"its_tenant": tenant, "its_map": map_id, **{f"more_{name}": count for name, count in more.items()}}
        last = connection.execute(_raised(), asked).one_or_none()
        if last is None:
            continue  # the map is gone, and with it whoever could ask for these
        first = {name: getattr(last, name) - count + 1 for name, count in more.items()}
        for seq, (row, enters) in enumerate(its.changes, first["changes"]):
            changes.append({**row, "seq": seq})
            entered += [{"its_number": row["submap_number"], "its_change": seq}] if enters else []
        for seq, (row, accepts) in enumerate(its.events, first["events"]):
            events.append({**row, "seq": seq})
            loop = {"its_tenant": tenant, "its_map": map_id, "its_loop": row["subject"], "its_event": seq}
            accepted += [loop] if accepts else []
        submaps += [{"its_number": number, "its_seq": seq} for seq, number in enumerate(its.submaps, first["submaps"])]
    for statement, rows in (
        (insert(tables.index_changes), changes),
        (insert(tables.events), events),
        (_numbered_submap(), submaps),
        (_entered_submap(), entered),
        (_accepted_loop(), accepted),
    ):
        if rows:
            connection.execute(statement, rows)


@cache
def _raised() -> ReturningUpdate[Any]:
    """Raises the counters of map `its_map` of `its_tenant` by `more_changes`, `more_events` and `more_submaps`."""
    counters = tables.map_counters
    names = ("changes", "events", "submaps")
    own = (counters.c.tenant == bindparam("its_tenant"), counters.c.map_id == bindparam("its_map"))
    raised = {name: counters.c[name] + bindparam(f"more_{name}") for name in names}
    return update(counters).where(*own).values(raised).returning(*(counters.c[name] for name in names))


@cache
def _numbered_submap() -> Update:
    submaps = tables.submaps
    return update(submaps).where(submaps.c.number == bindparam("its_number")).values(seq=bindparam("its_seq"))


@cache
def _entered_submap() -> Update:
    submaps = tables.submaps
    return update(submaps).where(submaps.c.number == bindparam("its_number")).values(entered=bindparam("its_change"))


@cache
def _accepted_loop() -> Update:
    loops = tables.loops
    key = (loops.c.tenant == bindparam("its_tenant"), loops.c.map_id == bindparam("its_map"))
    return update(loops).where(*key, loops.c.loop_id == bindparam("its_loop")).values(seq=bindparam("its_event"))
