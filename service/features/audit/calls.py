"""The audit log: rows that are only ever added, each bound to the one before it by a hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.service.domain.callers import current_actor
from revisit.service.domain.identity import TenantId
from revisit.service.ports.access import AuditRecord
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

NOTHING_BEFORE = "0" * 64
"""The previous hash of the first row."""

MAX_SUBJECT_CHARACTERS = 256
_BATCH = 1000


@dataclass(frozen=True)
class AuditEntry:
    """An audit entry: actor, action, subject. `detail` is JSON and holds no secret."""

    tenant: str
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]


@dataclass(frozen=True)
class AuditVerdict:
    """Whether the log is whole. `head` is the hash of the last row; `fault` names the first row that does not fit."""

    rows: int
    head: str
    fault: str | None


def noted(tenant: TenantId, action: str, subject: str, **detail: Any) -> AuditEntry:
    """An entry for an action of this request's caller."""
    return AuditEntry(tenant, current_actor(), action, printable(subject), detail)


def append(uow: UnitOfWork, at_ns: int, entry: AuditEntry) -> None:
    """Add a row in this transaction, so that it is there exactly if the change it tells of is."""
    last = uow.audit.last()
    row = AuditRecord(
        number=1 if last is None else last.number + 1,
        at_ns=at_ns,
        tenant=entry.tenant,
        actor=entry.actor,
        action=entry.action,
        subject=entry.subject,
        detail=entry.detail,
        previous_hash=NOTHING_BEFORE if last is None else last.hash,
        hash="",
    )
    uow.audit.append(replace(row, hash=row_hash(row)))


def row_hash(row: AuditRecord) -> str:
    """SHA-256 (hex) of everything in a row but its own hash."""
    content = [row.number, row.at_ns, row.tenant, row.actor, row.action, row.subject, row.detail, row.previous_hash]
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def judge(rows: Iterable[AuditRecord], highest: int) -> AuditVerdict:
    """Whether `rows` follow each other from number 1 to `highest`, the highest number ever given out."""
    count, head = 0, NOTHING_BEFORE
    for row in rows:
        if row.number != count + 1:
            return AuditVerdict(count, head, f"row {count + 1} is missing")
        if row.previous_hash != head or row.hash != row_hash(row):
            return AuditVerdict(count, head, f"row {row.number} was changed")
        count, head = row.number, row.hash
    missing = f"rows {count + 1} to {highest} are missing" if count < highest else None
    return AuditVerdict(count, head, missing)


def printable(text: str) -> str:
    """ASCII of bounded length without control characters: clients choose a part of it."""
    return "".join(c if " " <= c <= "~" else "?" for c in text[:MAX_SUBJECT_CHARACTERS])


class AuditLog:
    """List and verify."""

    def __init__(self, storage: Storage, clock: Clock) -> None:
        """The log is in `storage`."""
        self._storage = storage
        self._clock = clock

    async def note(self, entry: AuditEntry) -> None:
        """Add a row in a transaction of its own. Raises StorageFull, StorageUncertain."""
        await self._storage.write(partial(append, at_ns=self._clock.wall_ns(), entry=entry))

    async def newest(self, limit: int) -> list[AuditRecord]:
        """The last `limit` rows, oldest first."""
        return await self._storage.read(lambda uow: uow.audit.since(max(0, uow.audit.highest() - limit), limit))

    async def holds(self, number: int, row_hash: str) -> bool:
        """Whether row `number` is there with this hash."""
        rows = await self._storage.read(lambda uow: uow.audit.since(number - 1, 1))
        return [(row.number, row.hash) for row in rows] == [(number, row_hash)]

    async def verify(self) -> AuditVerdict:
        """Read every row and check the chain."""
        return await self._storage.read(lambda uow: judge(_all(uow), uow.audit.highest()))


def _all(uow: UnitOfWork) -> Iterator[AuditRecord]:
    number = 0
    while rows := uow.audit.since(number, _BATCH):
        yield from rows
        number = rows[-1].number
