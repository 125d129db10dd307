"""The conversation: views of a robot that moves narrow down where in a map it is.

A pose is told alone only where an accepted pair says it (`core.acceptance`), no other pose holds beside it, and the
views that followed did not contradict it (docs/decisions/0339).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from revisit.core.acceptance import Doubt, LoopClaim, StationInMap
from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import RejectionReason
from revisit.core.relocalisation.answer import PossiblePose, RelocalisationAnswer, RelocalisationState, UnknownReason
from revisit.core.relocalisation.hypotheses import (
    Hypothesis,
    Sighting,
    agree,
    begun,
    borne_out,
    sightings_of,
)


@dataclass(frozen=True)
class View:
    """What a view of the way was compared with.

    claims: pairs judged by `acceptance.accept_cloud`, and where their matches lie in the map; the frame of a match that
    the map does not place is that of its drive. near: for each hypothesis, by its order, whether a place that is stored
    near it was compared.
    """

    T_odom_view: Matrix4
    travelled_m: float
    claims: Sequence[LoopClaim]
    in_map: Sequence[StationInMap]
    near: Sequence[bool] = ()


@dataclass(frozen=True)
class ConversationState:
    """All that a conversation remembers: plain values, to be carried from view to view.

    hypotheses, the heaviest first; none: the log weight of none of them; counted_m: travel at the last view that
    counted, None before the first; repeating: views in a row in which places repeat; supported_m: travel at the last
    view that bore anything out.
    """

    hypotheses: tuple[Hypothesis, ...] = ()
    none: float = 0.0
    counted_m: float | None = None
    repeating: int = 0
    supported_m: float = 0.0


class Relocalisation:
    """A conversation. The same views give the same answers; nothing in it is random."""

    def __init__(self, config: PipelineConfig, state: ConversationState = ConversationState()) -> None:
        """It goes on from a `state`."""
        self._config = config
        self.state = state

    def expected(self, T_odom_view: Matrix4) -> list[tuple[str, Matrix4]]:
        """Where each hypothesis, in order, puts a view: frame and T_frame_view (4, 4)."""
        return [(one.frame, one.carried(T_odom_view)) for one in self.state.hypotheses]

    @property
    def has_begun(self) -> bool:
        """Whether a view was taken in."""
        return self.state.counted_m is not None

    def knows(self, frame: str, T_frame_view: Matrix4, T_odom_view: Matrix4) -> bool:
        """Whether a pair was accepted at this pose of a view before."""
        same = (one for one in self.state.hypotheses if one.frame == frame and one.accepted)
        return any(agree(one.carried(T_odom_view), T_frame_view) for one in same)

    def lost(self, travelled_m: float) -> RelocalisationAnswer:
        """The answer after a view that cannot be described: it says nothing."""
        return self._unknown(UnknownReason.TOO_FEW_RETURNS, travelled_m)

    def in_empty_map(self, travelled_m: float) -> RelocalisationAnswer:
        """The answer where the map has nothing to compare with."""
        return self._unknown(UnknownReason.MAP_IS_EMPTY, travelled_m)

    def observe(self, view: View) -> RelocalisationAnswer:
        """Take in a view."""
        said = sightings_of(view.claims, view.in_map)
        novelty = self._novelty(view.travelled_m)
        known = self._weighed(view, said, novelty)
        least = self.config_overlap
        fresh = self._begun(view, [one for one in said if one.fit >= least], known, novelty)
        none = self.state.none + self._share_for_none(said, novelty) * _none_after(said, least)
        repeats = _repeats(view.claims)
        supported = any(one.passes for one in said)
        self.state = ConversationState(
            *_normalised(_merged([*known, *fresh], view.T_odom_view), none),
            counted_m=view.travelled_m if novelty > 0.0 else self.state.counted_m,
            repeating=self.state.repeating + 1 if repeats else 0,
            supported_m=view.travelled_m if supported else self.state.supported_m,
        )
        return self._answer(view)

    @property
    def config_overlap(self) -> float:
        """The share of a view that a pose must explain to be a hypothesis."""
        return self._config.verification.min_overlap

    def _novelty(self, travelled_m: float) -> float:
        """The share of a view that the views before it have not seen."""
        if self.state.counted_m is None:
            return 1.0
        return float(np.clip((travelled_m - self.state.counted_m) / self._config.submap.tau, 0.0, 1.0))

    def _share_for_none(self, said: Sequence[Sighting], novelty: float) -> float:
        """The share of a view that counts against none of the poses: all of it where a pair is accepted first."""
        first = not any(one.accepted for one in self.state.hypotheses) and any(one.accepted for one in said)
        return 1.0 if first else novelty

    def _weighed(self, view: View, said: Sequence[Sighting], novelty: float) -> list[Hypothesis]:
        """The hypotheses so far with what the view says of them."""
        best = max([one.fit for one in said], default=0.0)
        weighed = []
        for row, known in enumerate(self.state.hypotheses):
            found = _agreeing(known, said, view)
            compared = row < len(view.near) and view.near[row]
            gain = _gain(found, best, compared=compared) if best >= self.config_overlap else _lost(compared=compared)
            log_weight = known.log_weight + novelty * gain
            if found is None or found.fit < self.config_overlap:
                weighed.append(_with_weight(known, log_weight))
            elif novelty > 0.0:
                weighed.append(borne_out(known, found, view.T_odom_view, view.travelled_m, log_weight))
            else:
                weighed.append(known)
        return weighed

    def _begun(
        self, view: View, said: Sequence[Sighting], known: Sequence[Hypothesis], novelty: float
    ) -> list[Hypothesis]:
        """New hypotheses: what the view says beside those that are known, each once."""
        best = max([one.fit for one in said], default=0.0)
        fresh: list[Hypothesis] = []
        for one in sorted(said, key=_by_strength):
            same = (two for two in [*known, *fresh] if two.frame == one.frame)
            if any(_is_of(two, one, view) for two in same):
                continue
            weight = self.state.none + max(novelty, _LEAST_NOVELTY) * _gain(one, best, compared=True)
            fresh.append(begun(one, view.T_odom_view, view.travelled_m, weight))
        return fresh

    def _answer(self, view: View) -> RelocalisationAnswer:
        shares, none = self._probabilities()
        told = [(one, share) for one, share in zip(self.state.hypotheses, shares, strict=True) if share >= _TOLD]
        if not told or none >= shares[0]:
            return self._unknown(self._why(view), view.travelled_m)
        first = self.state.hypotheses[0]
        if self._is_placed(first, none):
            alone = self._possible(first, shares[0], view)
            return RelocalisationAnswer(RelocalisationState.PLACED, (alone,), none, view.travelled_m)
        if len(self.state.hypotheses) >= MOST and self.state.repeating and shares[0] < _STANDS_OUT:
            return self._unknown(UnknownReason.PLACES_REPEAT, view.travelled_m)
        poses = tuple(self._possible(one, share, view) for one, share in told)
        return RelocalisationAnswer(RelocalisationState.SEVERAL, poses, none, view.travelled_m)

    def _is_placed(self, first: Hypothesis, none: float) -> bool:
        """Whether the heaviest stands alone: an accepted pair says it, and each other is refuted."""
        if first.accepted == 0 or none > _HARDLY_NONE:
            return False
        return all(_is_refuted(other, first) for other in self.state.hypotheses[1:])

    def _possible(self, one: Hypothesis, share: float, view: View) -> PossiblePose:
        pose, covariance = one.carried(view.T_odom_view), one.covariance_at(view.travelled_m)
        return PossiblePose(one.frame, pose, covariance, share, one.views, one.accepted, one.to_m - one.from_m)

    def _probabilities(self) -> tuple[list[float], float]:
        weights = np.exp([*(one.log_weight for one in self.state.hypotheses), self.state.none])
        shares = weights / weights.sum()
        return shares[:-1].tolist(), float(shares[-1])

    def _unknown(self, reason: UnknownReason, travelled_m: float) -> RelocalisationAnswer:
        return RelocalisationAnswer(RelocalisationState.UNKNOWN, (), 1.0, travelled_m, reason)

    def _why(self, view: View) -> UnknownReason:
        if self.state.repeating:
            return UnknownReason.PLACES_REPEAT
        if view.travelled_m - self.state.supported_m >= UNSUPPORTED_M:
            return UnknownReason.NOT_IN_MAP
        return UnknownReason.NOT_YET


def _agreeing(known: Hypothesis, said: Sequence[Sighting], view: View) -> Sighting | None:
    """The sighting that explains most of a view at a hypothesis."""
    there = [one for one in said if one.frame == known.frame and _is_of(known, one, view)]
    return min(there, key=_by_strength, default=None)


def _is_of(known: Hypothesis, said: Sighting, view: View) -> bool:
    return agree(known.carried(view.T_odom_view), said.T_frame_view, view.travelled_m - known.to_m)


def _by_strength(said: Sighting) -> tuple[float, ...]:
    """Order of sightings: the strongest first, ties by where they are, never by the order in which they came."""
    return (-float(said.accepted), -said.fit, *np.round(said.T_frame_view[:3, 3], 6).tolist())


def _gain(found: Sighting | None, best: float, *, compared: bool) -> float:
    """The log weight that a hypothesis gains or loses by a view of which the best pose explains `best`."""
    if found is None:
        return _REFUTED if compared else _UNSEEN
    return max(_SHARPNESS * math.log(max(found.fit / best, 1e-6)), _REFUTED)


def _lost(*, compared: bool) -> float:
    """The log weight that a hypothesis loses by a view that nothing explains."""
    return _MISSED if compared else _LEFT


def _none_after(said: Sequence[Sighting], least: float) -> float:
    """The log weight that none of the hypotheses gains or loses by a view."""
    if any(one.accepted for one in said):
        return _NONE_IF_ACCEPTED
    if any(one.passes for one in said):
        return _NONE_IF_PASSED
    return _NONE_IF_SEEN if any(one.fit >= least for one in said) else 0.0


def _merged(hypotheses: Sequence[Hypothesis], T_odom_view: Matrix4) -> list[Hypothesis]:
    """Those that agree as one, the heavier of them: equal evidence counts once."""
    kept: list[Hypothesis] = []
    for one in sorted(hypotheses, key=_by_weight):
        pose = one.carried(T_odom_view)
        if not any(two.frame == one.frame and agree(two.carried(T_odom_view), pose) for two in kept):
            kept.append(one)
    return kept


def _normalised(hypotheses: Sequence[Hypothesis], none: float) -> tuple[tuple[Hypothesis, ...], float]:
    """The heaviest of them and none, relative to the heaviest of all; what is refuted is forgotten."""
    top = max([none, *(one.log_weight for one in hypotheses)])
    kept = [_with_weight(one, one.log_weight - top) for one in hypotheses if one.log_weight - top > _FORGOTTEN]
    return tuple(kept[:MOST]), max(none - top, _NEVER_SURER)


def _by_weight(one: Hypothesis) -> tuple[float, ...]:
    return (-one.log_weight, -one.accepted, *np.round(one.T_frame_odom[:3, 3], 6).tolist())


def _with_weight(one: Hypothesis, log_weight: float) -> Hypothesis:
    return replace(one, log_weight=log_weight)


def _is_refuted(other: Hypothesis, first: Hypothesis) -> bool:
    """Whether a hypothesis holds no more beside the heaviest. One in another frame may be the same place."""
    if other.frame != first.frame and other.accepted == 0:
        return True
    return first.log_weight - other.log_weight > (_RIVAL_OF_LOOPS if other.accepted else _RIVAL)


def _repeats(claims: Sequence[LoopClaim]) -> bool:
    """Whether more of the places that were compared fit at several poses, or at any, than fit at one."""
    looked = [one for one in claims if one.measurement is not None]
    alike = [
        one
        for one in looked
        if one.ambiguous or one.reason == RejectionReason.DEGENERATE_ALIGNMENT or Doubt.PERCEPTUAL_ALIAS in one.doubts
    ]
    return len(alike) >= max(_ALIKE, 0.5 * len(looked)) and not any(one.accepted for one in claims)


MOST = 24
"""Hypotheses that are kept."""

UNSUPPORTED_M = 30.0
"""After so many metres without anything that fits the place is not in the map."""

_SHARPNESS = math.log(20.0) / -math.log(0.65)  # a pose of 0.65 of the best fit is one in twenty (0267: comparable)
_REFUTED = -6.0
_UNSEEN = -1.5
_MISSED, _LEFT = -math.log(8.0), -math.log(1.3)
_NONE_IF_ACCEPTED = math.log(1 / 50)
_NONE_IF_PASSED = math.log(1 / 4)
_NONE_IF_SEEN = math.log(2.0)
_LEAST_NOVELTY = 0.5
_NEVER_SURER = -8.0
_FORGOTTEN = -9.0
_RIVAL, _RIVAL_OF_LOOPS = math.log(20.0), math.log(400.0)
_TOLD = 0.01
_STANDS_OUT = 0.25
_HARDLY_NONE = 0.1
_ALIKE = 4
