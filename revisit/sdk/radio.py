"""Readings of radio as a client makes them: addresses of access points leave the robot as hashes."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from revisit.core.radio import FAINTEST_DBM, IDENTIFIER_BYTES, MOST_HEARD

READINGS_AT_ONCE = 100
"""Of one call."""


@dataclass(frozen=True)
class RadioReading:
    """What a robot's Wi-Fi hears at `stamp_ns`: the strength, dBm, by the address of the access point (BSSID)."""

    stamp_ns: int
    heard: Mapping[str, float]

    def message(self, key: bytes) -> dict[str, Any]:
        """The fields of a RadioReading of the interface: the strongest, hashed with the `key`."""
        strongest = sorted(self.heard, key=lambda bssid: (-self.heard[bssid], bssid))[:MOST_HEARD]
        hashed = {hashed_address(bssid, key): self.heard[bssid] for bssid in reversed(strongest)}
        return {
            "stamp_ns": self.stamp_ns,
            "access_points": [*hashed],
            "strengths_dbm": [round(min(max(dbm, FAINTEST_DBM), 0.0)) for dbm in hashed.values()],
        }


def hashed_address(bssid: str, key: bytes) -> str:
    """The identifier (16 hex digits) of an access point: HMAC-SHA-256 of its address without marks, lower case."""
    plain = "".join(mark for mark in bssid.lower() if mark.isalnum())
    return hmac.digest(key, plain.encode(), hashlib.sha256)[:IDENTIFIER_BYTES].hex()
