"""Made-up claims of two drives along x."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from revisit.core.acceptance import Doubt, Grounds, LoopClaim, Station
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from tests.support.verdicts import ambiguous, rejected, verified

STRIDE_M = 5.0
WORDS = Grounds("said otherwise")


def along_x(x_m: float, y_m: float = 0.0) -> Matrix4:
    """A pose without a turn."""
    return se3.from_yaw(0.0, (x_m, y_m, 0.0))


def at(x_m: float, drive: int = 1, stride_m: float = STRIDE_M) -> Station:
    """A submap at `x_m` of a drive that has one every `stride_m`."""
    return Station(drive, int(x_m // stride_m), along_x(x_m))


def pair(
    query: Station, match: Station, poses: Sequence[Matrix4], reason: str | None = None, score: float = 0.9, **told
) -> LoopClaim:
    """A pair that passed, or did not for a reason; where it is AMBIGUOUS the poses but the first are its rivals."""
    if reason is None:
        return LoopClaim(query, match, verified(poses[0], score, **told))
    if reason == "AMBIGUOUS":
        return LoopClaim(query, match, ambiguous(poses, score, **told))
    return LoopClaim(query, match, rejected(reason, poses[0] if poses else None, score, **told))


def doubted(claim: LoopClaim, *doubts: Doubt) -> LoopClaim:
    """The claim with doubts."""
    return replace(claim, doubts=dict.fromkeys(doubts, WORDS))
