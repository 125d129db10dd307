"""Readings of radio: posted with a session, before the scans around them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from revisit.core.errors import BadField
from revisit.core.radio import IDENTIFIER_BYTES, MOST_HEARD, RadioFingerprint
from revisit.service.capacity.limits import READING_POINTS, STORED_READING_POINTS
from revisit.service.domain import limits
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import RadioReadingRecord
from revisit.service.features.radio.rows import slice_of
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.storage import require_session
from revisit.service.ports.transactions import UnitOfWork

_IDENTIFIER = re.compile(rf"[0-9a-f]{{{2 * IDENTIFIER_BYTES}}}")


@dataclass(frozen=True)
class RadioReading:
    """The access points heard at `stamp_ns`, 16 hex digits each, and the strength of each, dBm."""

    stamp_ns: int
    access_points: tuple[str, ...]
    strengths_dbm: tuple[int, ...]

    def record(self, tenant: TenantId, key: SessionKey) -> RadioReadingRecord:
        """The row. Raises BadField."""
        limits.STAMP_NS.validated(self.stamp_ns, "stamp_ns")
        names = self.access_points
        if not 1 <= len(names) <= MOST_HEARD or len(set(names)) != len(names):
            raise BadField(f"a reading must have 1 to {MOST_HEARD} access points, none twice", field="access_points")
        if not all(map(_IDENTIFIER.fullmatch, names)):
            raise BadField(f"an access point has {2 * IDENTIFIER_BYTES} hex digits", field="access_points")
        if len(self.strengths_dbm) != len(names) or any(dbm not in limits.STRENGTH_DBM for dbm in self.strengths_dbm):
            message = f"strengths_dbm must hold as many numbers as access_points, each in {limits.STRENGTH_DBM}"
            raise BadField(message, field="strengths_dbm")
        heard = dict(zip(map(bytes.fromhex, names), map(float, self.strengths_dbm), strict=True))
        stored = RadioFingerprint.of([heard]).to_bytes()
        return RadioReadingRecord(tenant, key.map_id, key.session_id, self.stamp_ns, slice_of(self.stamp_ns), stored)


class Radio:
    """Posts readings."""

    def __init__(self, context: CallContext) -> None:
        """Readings are kept in the storage of the context."""
        self._context = context

    async def post(self, tenant: TenantId, key: SessionKey, readings: Sequence[RadioReading]) -> int:
        """Store readings of a session, all or none; how many were not there yet.

        Raises BadField, NotFound; AlreadyExists for other content at the same time; Draining, RateLimited,
        QuotaReached.
        """
        limits.READINGS.validated(len(readings), "readings")
        rows = [one.record(tenant, key) for one in readings]
        if len({row.stamp_ns for row in rows}) != len(rows):
            raise BadField("two readings have one time", field="stamp_ns")
        self._context.admission.charge_creation(tenant, READING_POINTS * len(rows))
        await self._context.admission.require_room(tenant)
        stored = await self._context.storage.write(partial(_store, key=key, rows=rows))
        self._context.admission.note_stored(tenant, STORED_READING_POINTS * stored)
        return stored


def _store(uow: UnitOfWork, key: SessionKey, rows: Sequence[RadioReadingRecord]) -> int:
    """Add those that are not there. Raises NotFound, AlreadyExists, BadField."""
    tenant = rows[0].tenant
    require_session(uow, tenant, key, hold=True)
    new = []
    for row in rows:
        known = uow.radio_readings.get(tenant, key.map_id, key.session_id, row.stamp_ns)
        if known is None:
            new.append(row)
        elif known.heard != row.heard:
            raise AlreadyExists(f"{key.name} has another reading of time {row.stamp_ns}")
    of_session = uow.radio_readings.count(tenant, map_id=key.map_id, session_id=key.session_id)
    if new and of_session + len(new) > limits.READINGS_OF_SESSION:
        raise BadField(f"a session has at most {limits.READINGS_OF_SESSION} readings of radio", field="readings")
    uow.radio_readings.add_all(new)
    return len(new)
