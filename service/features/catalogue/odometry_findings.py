"""Faults of a session's odometry by the map's version in force, as findings of the session."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from revisit.core.pose_graph.faults import OdometryFault
from revisit.service.domain.records import SessionRecord
from revisit.service.ports.map_optimiser import FAULTS
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class SessionFinding:
    """A likely mistake in a number of submaps of a session, and its most likely cause."""

    code: str
    submaps: int
    cause: str
    advice: str


_AT_ONCE = {
    "SLIP": ("lost or made up {}", "m", "wheels that slip, or scans without structure along the way"),
    "JUMP": ("jumped by {}", "m", "an odometry that began anew or was corrected"),
    "TURN": ("turned by {}", "degrees", "a gyro that was late or saturated, or a robot that was lifted"),
    "TILT": ("tilted by {}", "degrees", "a kerb, a ramp's edge or a robot that was lifted"),
}
_THROUGHOUT = {
    "SCALE": ("is wrong by {} of each length", "%", "the circumference of the wheels, or the scale of a camera"),
    "SLOPE": ("climbs by {} of the way", "%", "a sensor that is mounted askew (pitch)"),
    "HEADING": ("turns by {} a metre", "degrees", "the bias of a gyro"),
}


def odometry_findings(uow: UnitOfWork, session: SessionRecord) -> Iterator[SessionFinding]:
    """The faults of its odometry that the map's version in force has mended."""
    record = uow.maps.get(session.tenant, session.map_id)
    version = None if record is None else uow.map_versions.get(session.tenant, session.map_id, record.map_version)
    for fields in () if version is None else version.summary.get(FAULTS, ()):
        of_fault = dict(fields)
        if of_fault.pop("session_number") == session.number:
            yield _finding(OdometryFault(str(session.number), **of_fault))


def _finding(fault: OdometryFault) -> SessionFinding:
    did, unit, cause = (_AT_ONCE | _THROUGHOUT)[fault.kind]
    factor = {"m": 1.0, "degrees": 180.0 / math.pi, "%": 100.0}[unit]
    amount = f"{abs(factor * fault.amount):.2g} {unit} (standard deviation {factor * fault.sigma:.1g})"
    where = f"between submaps {fault.first + 1} and {fault.last + 1} " if fault.kind in _AT_ONCE else ""
    return SessionFinding(
        f"odometry_{fault.kind.lower()}",
        fault.last - fault.first + 1,
        f"{where}its odometry {did.format(amount)}, as {fault.loops} loops say: {cause}",
        "the map has it mended; mend the odometry before the next drive",
    )
