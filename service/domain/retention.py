"""Retention: what a map keeps of its submaps, for how long, and how an operator writes it down.

Nothing is removed by default. A policy is one line of text, `scans=24h,best=2,rejected=30d`: settings, commands and
`revisit plan` share it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any

from revisit.core.errors import BadField
from revisit.service.domain import limits

HOUR_NS = 3_600_000_000_000
DAY_NS = 24 * HOUR_NS


class KeptScans(StrEnum):
    """Which scans are kept of a submap: all, those that its description was made of, or none."""

    ALL = "ALL"
    DESCRIBED = "DESCRIBED"
    NONE = "NONE"


class RetentionRule(StrEnum):
    """A rule by which something was removed."""

    SESSIONS = "SESSIONS"
    BEST_SUBMAPS = "BEST_SUBMAPS"
    SCANS = "SCANS"
    REJECTED_LOOPS = "REJECTED_LOOPS"
    RETIRED_MAPS = "RETIRED_MAPS"


class Redescription(StrEnum):
    """What a later model can describe the submaps of a map from."""

    FROM_SCANS = "FROM_SCANS"
    FROM_NEURAL_MAPS = "FROM_NEURAL_MAPS"


BOUNDS = {
    "scans_after_hours": limits.SCANS_AFTER_HOURS,
    "best_submaps": limits.BEST_SUBMAPS,
    "session_days": limits.RETENTION_DAYS,
    "dropped_session_days": limits.RETENTION_DAYS,
    "rejected_days": limits.RETENTION_DAYS,
    "retired_days": limits.RETENTION_DAYS,
}
"""The bound of each number of a `RetentionPolicy`."""


@dataclass(frozen=True)
class RetentionPolicy:
    """What a map keeps. None of a number: the rule removes nothing.

    `keep_scans` says which scans stay once `scans_after_hours` hours have passed since their submap was described.
    `best_submaps`: the best so many submaps of a place stay in the index with their blobs; the others are retired.
    `session_days`: a session that ended so many days ago goes; where the map rests on it, its submaps are retired.
    `dropped_session_days`: the same of sessions that the map does not rest on. `rejected_days`: so long the evidence of
    rejected pairs stays. `retired_days`: so long after the end of its session a retired submap keeps its neural map,
    where a later drive shows its place.
    """

    keep_scans: KeptScans = KeptScans.ALL
    scans_after_hours: float = 0.0
    best_submaps: int | None = None
    session_days: float | None = None
    dropped_session_days: float | None = None
    rejected_days: float | None = None
    retired_days: float | None = None

    @property
    def redescription(self) -> Redescription:
        """What submaps can be described from again where this policy has done its work."""
        gone = self.keep_scans is KeptScans.NONE
        return Redescription.FROM_NEURAL_MAPS if gone else Redescription.FROM_SCANS

    def validated(self) -> RetentionPolicy:
        """Itself. Raises BadField where a value is out of its bounds."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in BOUNDS and value is not None:
                BOUNDS[field.name].validated(value, f"policy.{field.name}")
        return self

    def __str__(self) -> str:
        """The inverse of `parsed`; empty where everything is kept."""
        return ",".join(word for word in (self._scans(), *map(self._number, _NUMBERS)) if word)

    def _scans(self) -> str:
        if self.keep_scans is KeptScans.ALL:
            return ""
        after = f"{self.scans_after_hours:g}h" if self.scans_after_hours else ""
        if self.keep_scans is KeptScans.NONE:
            return f"scans={after or 'none'}"
        return f"scans=described{':' * bool(after)}{after}"

    def _number(self, name: str) -> str:
        field, unit = _NUMBERS[name]
        value = getattr(self, field)
        return "" if value is None else f"{name}={value:g}{unit}"


KEEPS_ALL = RetentionPolicy()

_NUMBERS: Mapping[str, tuple[str, str]] = {
    "best": ("best_submaps", ""),
    "sessions": ("session_days", "d"),
    "dropped": ("dropped_session_days", "d"),
    "rejected": ("rejected_days", "d"),
    "retired": ("retired_days", "d"),
}
"""Word -> field and unit."""

_SCANS = re.compile(r"(?P<kept>all|none|described)|((?P<some>described):)?(?P<hours>\d+(\.\d+)?)h")

GRAMMAR = (
    "scans=all|described|none|HOURSh|described:HOURSh, best=N, sessions=DAYSd, dropped=DAYSd, rejected=DAYSd, "
    "retired=DAYSd"
)


def parsed(text: str) -> RetentionPolicy:
    """The policy that one line says, words in any order, separated by commas; "" keeps everything. Raises BadField."""
    policy = KEEPS_ALL
    for word in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = word.partition("=")
        read: Callable[[str], dict[str, Any]] | None = {"scans": _scans_of}.get(name)
        policy = replace(policy, **(read(value) if read else _number_of(name, value)))
    return policy.validated()


def _scans_of(value: str) -> dict[str, Any]:
    found = _SCANS.fullmatch(value)
    if found is None:
        raise _unreadable(f"scans={value}")
    if found["hours"] is None:
        return {"keep_scans": KeptScans(found["kept"].upper()), "scans_after_hours": 0.0}
    kept = KeptScans.DESCRIBED if found["some"] else KeptScans.NONE
    return {"keep_scans": kept, "scans_after_hours": float(found["hours"])}


def _number_of(name: str, value: str) -> dict[str, Any]:
    field, unit = _NUMBERS.get(name, ("", ""))
    number = value.removesuffix(unit)
    if not field or not re.fullmatch(r"\d+(\.\d+)?" if unit else r"\d+", number) or value != number + unit:
        raise _unreadable(f"{name}={value}")
    return {field: float(number) if unit else int(number)}


def _unreadable(word: str) -> BadField:
    return BadField(f"{word!r} is no rule of retention: {GRAMMAR}"[:300], field="retention")
