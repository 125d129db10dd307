"""RADIO_DISAGREES: a place that is alike, but hears other radio than one where the submap passes, too.

Storeys of one plan, wings of a school and aisles of a hall may be exact twins. The access points that a robot hears
there are not. How alike two fingerprints are tells nothing by itself: access points are replaced, and receivers differ.
So a place is refuted only beside another spot of the same drive, where the query passes as well and hears nearly the
same; and only while the loops on the way agree with radio, of which the first were accepted without it
(docs/decisions/0367).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim
from revisit.core.acceptance.distinctiveness import spot_of
from revisit.core.radio import likeness

ALIKE = 0.2
"""From this likeness on, two fingerprints may be of one surroundings. In a simulated building one place has 0.8, or 0.4
with a fifth of the identifiers false; storeys above each other have 0.2 (a ceiling of 17 dB)."""

FADE_M = 40.0
"""Over so many metres of a storey the likeness falls to a third: places 10 m apart have 0.63 there, 30 m apart 0.37."""

FURTHEST_M = 200.0
"""Nothing more is made up for beyond: submaps that share surfaces are nearer, but poses of clouds are anything."""

OTHER = 0.5
"""A place is another one where its likeness, less what the distance takes, is below this share of that elsewhere."""

SPOT_M = 2.0
"""Poses of one query nearer to each other than this are one spot, whichever submaps say so."""

LEAST_AGREEING, MOST_AGAINST = 2, 0.2
"""So many loops on the way must be of places that hear nearly the same, and so large a share at most of others."""


def radio_refuted(new: Sequence[LoopClaim], before: Sequence[LoopClaim]) -> dict[int, LoopClaim]:
    """The claims of one query that radio refutes, by row: a loop with that doubt, others as they are.

    `before`: earlier claims of its drive.
    """
    heard = {row: alike for row, one in enumerate(new) if one.hypotheses and (alike := _likeness(one)) is not None}
    if max(heard.values(), default=0.0) < ALIKE:
        return {}
    # A drive agrees with itself: this tells nothing of the drives of another day, whose access points may be gone.
    trusted = {own: _is_trusted([one for one in before if one.of_one_drive == own]) for own in (False, True)}
    near = {row: _near(new[row], alike) for row, alike in heard.items() if trusted[new[row].of_one_drive]}
    refuted = dict[int, LoopClaim]()
    for row, alike in near.items():
        beside = [other for other in near if heard[other] >= ALIKE and _are_two(new[row], new[other])]
        elsewhere = max(beside, key=near.__getitem__, default=row)
        if alike < OTHER * near[elsewhere]:
            refuted[row] = _refuted(new[row], heard[row], heard[elsewhere])
    return refuted


def _near(claim: LoopClaim, alike: float) -> float:
    """The likeness of a claim without what its distance takes, at most 1; of several poses the nearest counts."""
    away_m = min(float(np.linalg.norm(pose[:3, 3])) for pose in claim.hypotheses)
    return min(alike * math.exp(min(away_m, FURTHEST_M) / FADE_M), 1.0)


def _refuted(claim: LoopClaim, alike: float, elsewhere: float) -> LoopClaim:
    if not claim.accepted_by_itself or claim.by_hand:
        return claim
    words = f"it passed every check, but hears {alike:.2f} of the radio there, and {elsewhere:.2f} at another spot"
    return claim.doubted(Doubt.RADIO_DISAGREES, Grounds(words, {"radio": alike, "elsewhere": elsewhere}))


def _likeness(claim: LoopClaim) -> float | None:
    return likeness(claim.query.radio, claim.match.radio)


def _are_two(claim: LoopClaim, other: LoopClaim) -> bool:
    """Whether the query stands at two spots of one drive by two claims, whichever of their poses are true."""
    if claim is other or claim.match.drive != other.match.drive:
        return False
    here, there = (np.array([spot_of(one, pose)[0] for pose in one.hypotheses]) for one in (claim, other))
    return bool((np.linalg.norm(here[:, None] - there[None], axis=2) >= SPOT_M).all())


def _is_trusted(before: Sequence[LoopClaim]) -> bool:
    """Whether the loops on the way agree with radio: those that geometry alone has accepted, or radio before."""
    heard = [alike for one in before if one.accepted_by_itself and (alike := _likeness(one)) is not None]
    agreeing, against = sum(alike >= ALIKE for alike in heard), sum(alike < 0.5 * ALIKE for alike in heard)
    return agreeing >= LEAST_AGREEING and against <= MOST_AGAINST * (agreeing + against)
