"""Faults of odometry that a version of a map has mended: their stored form, and as clients see them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from revisit.core.pose_graph.faults import OdometryFault
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.domain.records import MapVersionRecord
from revisit.service.features.graph.reading import MapTask
from revisit.service.ports.map_optimiser import FAULTS
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class OdometryFaultView:
    """The fields of an OdometryFault."""

    session: str
    kind: str
    first_submap: str | None
    last_submap: str | None
    amount: float
    sigma: float
    loops: int
    submaps: int
    message: str
    undecided: bool


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
_UNDECIDED = "; or these loops take the place for another one that looks alike: not decided, and not mended"
_FACTORS = {"m": 1.0, "degrees": 180.0 / math.pi, "%": 100.0}


def stored_faults(task: MapTask, faults: Iterable[OdometryFault]) -> list[dict[str, Any]]:
    """Faults, whose `session` is a number, in the form of a version's summary: those of the task's sessions. Submaps
    are numbers, which say nothing once they are deleted.
    """
    tracks = {
        str(track.session_number): (SessionKey(task.map.map_id, name).name, track.submaps)
        for track, name in zip(task.graph.tracks, task.session_ids, strict=True)
    }
    return [
        {
            "session": tracks[one.session][0],
            "kind": one.kind.value,
            "first_number": tracks[one.session][1][one.first],
            "last_number": tracks[one.session][1][one.last],
            "submaps": one.last - one.first + 1,
            "amount": one.amount,
            "sigma": one.sigma,
            "loops": one.loops,
            **({"undecided": True} if one.undecided else {}),
        }
        for one in faults
        if one.session in tracks
    ]


def faults_of(
    uow: UnitOfWork, version: MapVersionRecord | None, session_id: str | None = None
) -> tuple[OdometryFaultView, ...]:
    """The faults of a version's sessions, or of one of them."""
    if version is None or FAULTS not in version.summary:
        return ()
    session = None if session_id is None else SessionKey(version.map_id, session_id).name
    stored = [one for one in version.summary[FAULTS] if session in (None, one["session"])]
    ends = {number for one in stored for number in (one["first_number"], one["last_number"])}
    known = uow.submaps.numbered(version.tenant, sorted(ends)) if ends else {}
    names = {number: SubmapKey(one.map_id, one.session_id, one.submap_id).name for number, one in known.items()}
    return tuple(_view(one, names) for one in stored)


def _view(stored: dict[str, Any], names: dict[int, str]) -> OdometryFaultView:
    kind = stored["kind"]
    first, last = names.get(stored["first_number"]), names.get(stored["last_number"])
    did, unit, cause = (_AT_ONCE | _THROUGHOUT)[kind]
    factor = _FACTORS[unit]
    amount, sigma = _rounded(abs(factor * stored["amount"]), 2), _rounded(factor * stored["sigma"], 1)
    amount = f"{amount} {unit} (standard deviation {sigma})"
    is_placed = kind in _AT_ONCE and first is not None and last is not None
    where = f"between submaps {_last(first)} and {_last(last)} " if is_placed else ""
    undecided = bool(stored.get("undecided"))
    telling = f"{stored['loops']} loops say" if stored["loops"] else "the time between them says"
    said = f"{where}its odometry {did.format(amount)}, as {telling}: {cause}"
    return OdometryFaultView(
        session=stored["session"],
        kind=kind,
        first_submap=first,
        last_submap=last,
        amount=stored["amount"],
        sigma=stored["sigma"],
        loops=stored["loops"],
        submaps=stored["submaps"],
        message=f"{said}{_UNDECIDED}" if undecided else said,
        undecided=undecided,
    )


def _rounded(value: float, digits: int) -> str:
    """A value to so many digits, without an exponent."""
    return f"{float(f'{value:.{digits}g}'):g}"


def _last(name: str | None) -> str:
    return "" if name is None else name.rpartition("/")[2]
