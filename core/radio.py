"""Radio fingerprints: which access points a robot has heard at a place, and how strongly.

Identifiers are hashes: nobody can tell an access point by them. Places are alike where the same are heard about as
strongly (weighted Jaccard index of squared levels above the faintest); this tells surroundings of tens of metres and
storeys, not a pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from revisit.core.errors import DataLoss

if TYPE_CHECKING:
    from typing import Self

MOST_HEARD = 64
"""Access points of a fingerprint: the strongest."""

LEAST_HEARD = 4
"""A fingerprint of fewer tells nothing."""

FAINTEST_DBM = -100.0
"""A strength of which nothing is left of a weight."""

IDENTIFIER_BYTES = 8
_ROW = np.dtype([("identifier", f"V{IDENTIFIER_BYTES}"), ("dbm", "i1")])


@dataclass(frozen=True)
class RadioFingerprint:
    """The access points of a place: identifiers, 8 bytes each, with their mean strength, dBm (-100 to 0)."""

    heard: Mapping[bytes, float]

    @classmethod
    def of(cls, readings: Iterable[Mapping[bytes, float]]) -> Self:
        """Of readings on the way through a place: the mean of those that heard it, the strongest MOST_HEARD."""
        found: dict[bytes, list[float]] = {}
        for reading in readings:
            for identifier, dbm in reading.items():
                found.setdefault(identifier, []).append(dbm)
        mean = {identifier: sum(values) / len(values) for identifier, values in found.items()}
        strongest = sorted(mean, key=lambda one: (-mean[one], one))[:MOST_HEARD]
        return cls({one: mean[one] for one in sorted(strongest)})

    @classmethod
    def of_bytes(cls, stored: bytes) -> Self:
        """The inverse of `to_bytes`, but for fractions of a decibel. Raises DataLoss."""
        if len(stored) % _ROW.itemsize:
            raise DataLoss("a stored fingerprint of radio is damaged")
        rows = np.frombuffer(stored, _ROW)
        return cls({row["identifier"].tobytes(): float(row["dbm"]) for row in rows})

    def to_bytes(self) -> bytes:
        """Nine bytes for each access point."""
        rows = np.empty(len(self.heard), _ROW)
        rows["identifier"] = np.frombuffer(b"".join(self.heard), _ROW["identifier"])
        rows["dbm"] = np.clip(np.round([*self.heard.values()]), FAINTEST_DBM, 0.0)
        return rows.tobytes()

    @property
    def tells(self) -> bool:
        """Whether it holds enough to be compared."""
        return len(self.heard) >= LEAST_HEARD


def likeness(one: RadioFingerprint | None, other: RadioFingerprint | None) -> float | None:
    """How alike two places hear, 0..1; None where one of them tells nothing."""
    if one is None or other is None or not (one.tells and other.tells):
        return None
    weights = [{name: max(dbm - FAINTEST_DBM, 1.0) ** 2 for name, dbm in its.heard.items()} for its in (one, other)]
    names = weights[0].keys() | weights[1].keys()
    both = [(weights[0].get(name, 0.0), weights[1].get(name, 0.0)) for name in names]
    return sum(map(min, both)) / sum(map(max, both))
