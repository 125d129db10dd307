"""Faults of a session's odometry by the map's version in force, as findings of the session."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from revisit.service.domain.records import SessionRecord
from revisit.service.features.graph.odometry_faults import OdometryFaultView, faults_of
from revisit.service.ports.transactions import UnitOfWork

_MENDED = "the map has it mended; mend the odometry before the next drive"
_UNDECIDED = "odometry_undecided"
_LOOK = (
    "one of both is wrong, and the map beyond may be off by so much: reject these loops where the place repeats, "
    "or drive on past other places that the map has"
)


@dataclass(frozen=True)
class SessionFinding:
    """A likely mistake in a number of submaps of a session, and its most likely cause; that of odometry in figures."""

    code: str
    submaps: int
    cause: str
    advice: str
    odometry_fault: OdometryFaultView | None = None


def odometry_findings(uow: UnitOfWork, session: SessionRecord) -> Iterator[SessionFinding]:
    """The faults of its odometry by the map's version in force, which has them mended but for undecided ones."""
    record = uow.maps.get(session.tenant, session.map_id)
    version = None if record is None else uow.map_versions.get(session.tenant, session.map_id, record.map_version)
    for fault in faults_of(uow, version, session.session_id):
        code, advice = (_UNDECIDED, _LOOK) if fault.undecided else (f"odometry_{fault.kind.lower()}", _MENDED)
        yield SessionFinding(code, fault.submaps, fault.message, advice, fault)
