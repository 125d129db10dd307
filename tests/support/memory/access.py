"""Keys and the audit log in memory."""

from __future__ import annotations

import dataclasses
from typing import Any

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.ports.access import AuditRecord, KeyRecord


class MemoryKeyRing:
    """`access_ports.KeyRing` over rows by number."""

    def __init__(self, by_number: dict[int, Any]) -> None:
        """Changes `by_number` in place."""
        self._by_number: dict[int, KeyRecord] = by_number

    def add(self, record: KeyRecord) -> KeyRecord:
        """See `access_ports.KeyRing`."""
        if self.get(record.key_id) is not None:
            raise AlreadyExists
        added = dataclasses.replace(record, number=len(self._by_number) + 1)
        self._by_number[added.number] = added
        return added

    def get(self, key_id: str, *, hold: bool = False) -> KeyRecord | None:
        """See `access_ports.KeyRing`."""
        return next((record for record in self._by_number.values() if record.key_id == key_id), None)

    def all(self) -> list[KeyRecord]:
        """See `access_ports.KeyRing`."""
        return list(self._by_number.values())

    def replace(self, record: KeyRecord) -> None:
        """See `access_ports.KeyRing`."""
        if record.number not in self._by_number:
            raise NotFound
        self._by_number[record.number] = record

    def is_empty(self) -> bool:
        """See `access_ports.KeyRing`."""
        return not self._by_number


class MemoryAuditTrail:
    """`access_ports.AuditTrail` over rows by number."""

    def __init__(self, by_number: dict[int, Any]) -> None:
        """Changes `by_number` in place."""
        self._by_number: dict[int, AuditRecord] = by_number

    def append(self, record: AuditRecord) -> None:
        """See `access_ports.AuditTrail`."""
        if record.number in self._by_number:
            raise AlreadyExists
        self._by_number[record.number] = record

    def last(self) -> AuditRecord | None:
        """See `access_ports.AuditTrail`."""
        return self._by_number.get(self.highest())

    def since(self, number: int, limit: int) -> list[AuditRecord]:
        """See `access_ports.AuditTrail`."""
        return [record for record in self._by_number.values() if record.number > number][:limit]

    def highest(self) -> int:
        """See `access_ports.AuditTrail`: rows are never taken away."""
        return max(self._by_number, default=0)
