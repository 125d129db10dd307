"""Every bound of a client's input, stated once.

The use cases check them. REST schemas, the OpenAPI description and the comments of the proto files repeat them,
and a test compares them. Bounds of whole messages, which a transport must know before it reads one, stay with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from revisit.core.errors import BadField
from revisit.core.radio import FAINTEST_DBM

N = TypeVar("N", int, float)


@dataclass(frozen=True)
class Range:
    """The numbers from `least` to `most`, both included; with `above`, `least` itself is excluded."""

    least: float
    most: float
    unit: str = ""
    above: bool = False

    def __contains__(self, value: float) -> bool:
        """Whether `value` is within the range, and so finite."""
        return self.least <= value <= self.most and not (self.above and value == self.least)

    def __str__(self) -> str:
        """The range as an error message states it."""
        bounds = f"{_number(self.least)}..{_number(self.most)}"
        return bounds + (f" {self.unit}" if self.unit else "") + (f", without {_number(self.least)}" * self.above)

    def validated(self, value: N, field: str) -> N:
        """`value`. Raises BadField naming `field` where it is out of range."""
        if value not in self:
            raise BadField(f"{field} must be in {self}", field=field)
        return value


def _number(value: float) -> str:
    return "2^63 - 1" if value == LARGEST_INTEGER else f"{value:,.10g}".replace(",", "")


LARGEST_INTEGER = 2**63 - 1
"""The database holds no larger one."""

# Names
ID_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""Of every id that a client chooses."""
ID_CHARACTERS = 64
RESOURCE_NAME_CHARACTERS = 300
DISPLAY_NAME_CHARACTERS = 256
"""Also of an API key's label."""
MODEL_VERSION_CHARACTERS = 100
STOREY_CHARACTERS = 64
"""Of the storey of a session."""
NOTE_CHARACTERS = 1000
"""A person's reason for a decision."""

# Maps
TAU_M = Range(0.1, 1000.0, "metres")
STRIDE_M = Range(0.1, 1000.0, "metres")
LEAVE_DISTANCE_M = Range(0.0, 10_000.0, "metres")
"""Of a map and of a search."""
SCENE_SCALE = Range(0.01, 10.0)
LOOP_CANDIDATES = Range(1, 100)
"""Submaps that are verified for each new one."""
MIN_SCORE = Range(0.0, 1.0)
MIN_OVERLAP = Range(0.0, 1.0)
MAX_SEEN_THROUGH = Range(0.0, 1.0)
MAP_VERSION = Range(1, LARGEST_INTEGER)
SCANS_AFTER_HOURS = Range(0.0, 876_000.0, "hours")
"""After the description of their submap, from when on scans need not be kept."""
BEST_SUBMAPS = Range(1, 100)
"""Of a place, that stay in the index."""
POLICY_CHARACTERS = 200
"""Of a policy of retention in one line."""
RETENTION_DAYS = Range(1 / 24, 36_500.0, "days")
"""From an hour on: what has just been judged, or driven, is still looked at."""

# Clouds
SCAN_SEQ = Range(1, LARGEST_INTEGER)
STAMP_NS = Range(0, LARGEST_INTEGER)
TRAVELLED_M = Range(0.0, 1e9, "metres")
"""Since the beginning of a session, as its robot counts."""
SCAN_POINTS = 500_000
SUBMAP_POINTS = 2_000_000
"""Of a posted submap and of a query by cloud."""
ASCII_CLOUD_BYTES = 8 * 2**20
"""Numbers as text cost a hundred times as much as the same points in binary: about 0.3 s of a core per megabyte."""

# Searches
K = Range(1, 100)
LOCALIZE_CANDIDATES = Range(1, 100)
MIN_SIMILARITY = Range(-1.0, 1.0)
RADIUS_M = Range(0.0, 1e6, "metres", above=True)
PRIOR_COORDINATE_M = Range(-1e9, 1e9, "metres")
DESCRIPTOR_LENGTH = Range(1, 10_000)

# Tiles of a map
DISTANCE_POINTS = Range(1, 1000)
"""Of which the distances to the surface are asked at once."""
MAP_RADIUS_M = Range(0.0, 100.0, "metres", above=True)
MAP_POINTS = Range(1, 2000)
"""Points of the surface in one answer."""
QUERY_TILES = 16
"""Tiles that one question may reach."""
TILE_WAIT_S = 60.0
"""How long an answer waits for the worker that makes its tiles or its mesh, seconds."""
MAP_FILES = 50
"""Of a map: the oldest that is not ENABLED is deleted when one more is published."""

# Anchors
ANCHORS = Range(1, 200)
"""Of one call."""
ANCHORS_OF_SESSION = 50_000
TAG_CHARACTERS = STOREY_CHARACTERS
"""Of the family and id of a tag."""
GEODETIC = {
    "latitude_deg": Range(-90.0, 90.0, "degrees"),
    "longitude_deg": Range(-180.0, 180.0, "degrees"),
    "altitude_m": Range(-10_000.0, 100_000.0, "metres"),
}
LOCAL = dict.fromkeys(("local_m.x", "local_m.y", "local_m.z"), Range(-1e6, 1e6, "metres"))
ANCHOR_OFFSET_M = Range(-1000.0, 1000.0, "metres")
PLACE_VARIANCE_M2 = Range(1e-6, 1e8, "m^2")
HEADING_RAD = Range(-10.0, 10.0, "radians")
HEADING_SIGMA_RAD = Range(1e-4, 1.0, "radians")

# Plans
PLAN_IMAGE_BYTES = 15 * 2**20
"""With the rest of its message it is within the bound of those over gRPC."""
PLAN_MEGAPIXELS = 100
PLAN_SIDE = Range(1, 30_000, "pixels")
PLAN_PIXEL = Range(0.0, 30_000.0, "pixels")
PLAN_COORDINATE_M = Range(-1e6, 1e6, "metres")
PLAN_METRES_PER_PIXEL = Range(1e-4, 1000.0, "metres")
PLAN_PINS_APART = 2.0
"""Two pins are so many pixels from each other, at least."""
PLANS_OF_MAP, PLAN_BYTES_OF_MAP = 20, 64 * 2**20

# Radio
READINGS = Range(1, 100)
"""Of one call."""
READINGS_OF_SESSION = 20_000
STRENGTH_DBM = Range(FAINTEST_DBM, 0.0, "dBm")

# Lists and waiting
PAGE_SIZE = Range(1, 500)
PAGE_TOKEN_CHARACTERS = 200
MIN_SEQ = Range(0, LARGEST_INTEGER)
URL_CHARACTERS = 2000
"""Of a webhook."""
WEBHOOKS = 20
"""That a tenant may have."""
REASON_CHARACTERS = 64
"""Of the reason by which rejected loop closures are kept in a list."""
EVENT_NUMBER = Range(0, LARGEST_INTEGER)
"""Of the event behind which a watch goes on."""
WAIT_S = Range(0.0, 60.0, "seconds")
"""For an operation, or for the submaps that an answer must rest on."""

# API keys
KEY_LIFETIME_S = Range(0.0, 100 * 365 * 86400.0, "seconds", above=True)
