"""PERCEPTUAL_ALIAS and BETTER_ALTERNATIVE: claims of submaps that other places look like as much, or more.

In a field of equal rows any two submaps overlap well and lose little aside, for want of anything that ends: contrast is
too low, and nothing is accepted. One pair of hundreds passes, at a wrong place. The other candidates of its query tell
it from a right one: elsewhere on that drive they fit as well, but for contrast. In a street of equal houses a wrong
pair passes now and then that explains less of the submap than a house elsewhere, which is turned down because two of
its neighbours fit as well. Between drives of which nothing is known yet, any place elsewhere counts
(docs/decisions/0267).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim, StationInMap
from revisit.core.acceptance.distinctiveness import SPOT_M, are_one, spot_of
from revisit.core.config import PipelineConfig
from revisit.core.pair_verdict import RejectionReason

_LEAST, _SHARE = 4, 0.75
"""So many candidates elsewhere, and so large a share of them, must look alike."""

_WINDOWS = 3.0
"""Submaps of a drive farther apart than this many window lengths are elsewhere."""

_COMPARABLE = 0.65
"""Such a share of the overlap of a cloud's claim is too much for another place (docs/decisions/0267)."""

Counts = Callable[[LoopClaim, PipelineConfig], bool]


def not_standing_out(claims: Sequence[LoopClaim], config: PipelineConfig) -> dict[int, LoopClaim]:
    """The accepted claims of one query that do not stand out from other places, by row, with that doubt."""
    changed = dict[int, LoopClaim]()
    for row, claim in _undoubted(claims):
        doubt = _perceptual_alias(claim, claims, config) or _better_alternative(claim, claims, config, _looks_alike)
        if doubt is not None:
            changed[row] = claim.doubted(*doubt)
    return changed


def outdone_contacts(
    claims: Sequence[LoopClaim], before: Sequence[LoopClaim], config: PipelineConfig
) -> dict[int, LoopClaim]:
    """The accepted claims of one query that are the first contact of two drives, and that another place outdoes.

    No accepted claim `before` on the drive prepares them; then a place elsewhere counts for any reason it failed.
    """
    met = {claim.match.drive for claim in before if claim.accepted}
    changed = dict[int, LoopClaim]()
    for row, claim in _undoubted(claims):
        if claim.match.drive not in met:
            doubt = _better_alternative(claim, claims, config, _overlaps)
            if doubt is not None:
                changed[row] = claim.doubted(*doubt)
    return changed


def without_twins(
    claims: Sequence[LoopClaim], in_map: Sequence[StationInMap | None], config: PipelineConfig
) -> dict[int, LoopClaim]:
    """The accepted claims of one cloud that another place explains nearly as well, by row, with that doubt.

    A cloud has no drive that could tell twins apart later. `in_map`: where the matches lie in the map. Of a drive that
    nothing places beside that of a claim, ambiguous claims count alone: others may be of the same spot.
    """
    changed = dict[int, LoopClaim]()
    for row, claim in _undoubted(claims):
        there = [_same_spot(claims, in_map, row, other, config) for other in range(len(claims))]
        own = max(one.overlap for one, same in zip(claims, there, strict=True) if same)
        elsewhere = [
            one.overlap
            for one, same in zip(claims, there, strict=True)
            if not same and (one.ambiguous if same is None else one.accepted or _overlaps(one, config))
        ]
        best = max(elsewhere, default=0.0)
        if best >= _COMPARABLE * own:
            words = f"it passed every check, but explains {own:.2f} of the cloud, and a place elsewhere {best:.2f}"
            grounds = Grounds(words, {"overlap": own, "elsewhere": best})
            changed[row] = claim.doubted(Doubt.BETTER_ALTERNATIVE, grounds)
    return changed


def _same_spot(
    claims: Sequence[LoopClaim],
    in_map: Sequence[StationInMap | None],
    row: int,
    other: int,
    config: PipelineConfig,
) -> bool | None:
    """Whether a claim may say the spot of that in `row`, by any of its poses; None where nothing tells."""
    claim, one = claims[row], claims[other]
    if one.match.drive == claim.match.drive:
        return other == row or _is_there(one, claim, config)
    here, there = in_map[row], in_map[other]
    if here is None or there is None or here.frame != there.frame:
        return None
    stands = (here.T_map_submap @ claim.hypotheses[0])[:3, 3]
    poses = one.hypotheses or (one.T_match_query,)
    spots = [(there.T_map_submap @ pose)[:3, 3] for pose in poses if pose is not None]
    return any(float(np.linalg.norm(spot - stands)) < SPOT_M for spot in spots)


def _undoubted(claims: Sequence[LoopClaim]) -> list[tuple[int, LoopClaim]]:
    return [(row, one) for row, one in enumerate(claims) if one.accepted_by_itself and not one.by_hand]


def _perceptual_alias(
    claim: LoopClaim, claims: Sequence[LoopClaim], config: PipelineConfig
) -> tuple[Doubt, Grounds] | None:
    """A doubt where nearly every other place of the matched drive looks like the submap."""
    elsewhere = [one for one in claims if _is_elsewhere(one, claim, config)]
    alike = sum(_looks_alike(one, config) for one in elsewhere)
    if alike < max(_LEAST, _SHARE * len(elsewhere)):
        return None
    words = f"it passed every check, but {alike} of {len(elsewhere)} other places of that drive look like it"
    return Doubt.PERCEPTUAL_ALIAS, Grounds(words, {"alike": alike, "elsewhere": len(elsewhere)})


def _better_alternative(
    claim: LoopClaim, claims: Sequence[LoopClaim], config: PipelineConfig, counts: Counts
) -> tuple[Doubt, Grounds] | None:
    """A doubt where a place elsewhere, on any drive, explains more of the submap.

    Of the spot of `claim` the best candidate counts, of other spots each that `counts`.
    """
    others = [one for one in claims if one is not claim and one.T_match_query is not None]
    there = [_is_there(one, claim, config) for one in others]
    own = max([claim.overlap, *(one.overlap for one, is_there in zip(others, there, strict=True) if is_there)])
    elsewhere = [one for one, is_there in zip(others, there, strict=True) if not is_there and counts(one, config)]
    best = max((one.overlap for one in elsewhere), default=None)
    if best is None or best < own:
        return None
    words = f"it passed every check, but explains {own:.2f} of the submap, and a place elsewhere {best:.2f}"
    return Doubt.BETTER_ALTERNATIVE, Grounds(words, {"overlap": own, "elsewhere": best})


def _is_there(one: LoopClaim, claim: LoopClaim, config: PipelineConfig) -> bool:
    """Whether a candidate may say the same spot as `claim`, by any of its poses."""
    if one.match.drive != claim.match.drive:
        return False
    poses = one.hypotheses or (one.T_match_query,)
    spot = spot_of(claim, claim.hypotheses[0])
    return any(pose is not None and are_one(spot_of(one, pose), spot, config.submap.stride) for pose in poses)


def _is_elsewhere(one: LoopClaim, claim: LoopClaim, config: PipelineConfig) -> bool:
    """Whether a candidate is another place of the drive that `claim` matches."""
    apart_m = float(np.linalg.norm(_position_m(one) - _position_m(claim)))
    return one.match.drive == claim.match.drive and apart_m > _WINDOWS * config.submap.tau


def _looks_alike(one: LoopClaim, config: PipelineConfig) -> bool:
    """Whether a candidate passes but for its contrast, or for other poses that fit as well."""
    rules = config.verification
    return (
        not one.accepted
        and one.reason in (RejectionReason.AMBIGUOUS, RejectionReason.DEGENERATE_ALIGNMENT)
        and one.overlap >= rules.min_overlap
        and one.score >= rules.min_score
    )


def _overlaps(one: LoopClaim, config: PipelineConfig) -> bool:
    """Whether a candidate was aligned and overlaps enough, but fails."""
    aligned = RejectionReason.AMBIGUOUS, RejectionReason.DEGENERATE_ALIGNMENT, RejectionReason.LOW_SCORE
    return not one.accepted and one.reason in aligned and one.overlap >= config.verification.min_overlap


def _position_m(claim: LoopClaim) -> NDArray[np.float64]:
    return np.asarray(claim.match.T_odom_submap[:3, 3])
