"""Rivals of an alignment: other poses that explain the surfaces about as well (docs/decisions/0080).

Where a place repeats, the best pose is one of several. Rivals are sought on purpose: the overlap of the two places over
all shifts and four turns, by correlation of coarse layered plans, then a few ICP steps from its largest maxima.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import maximum_filter

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.plan_images import hit_products, layer_counts, occupied_around, plan_peaks, plan_shares
from revisit.core.pair_verdict import Hypothesis
from revisit.core.verification.evidence import mutually_seen_through
from revisit.core.verification.oriented_points import OrientedPoints, shared_shares
from revisit.core.verification.overlap import overlap_beside
from revisit.core.verification.registration import iterate, iterate_all

Array64 = NDArray[np.float64]
Images = NDArray[np.float32]

PLAN_SIZE = 128
"""Pixels along an edge of the plans."""

_NEAR_STEP_M = 0.4  # half of what stands across a rack, and half of a pixel of the plans
_LAYERS = 4
_LAYER_M = 1.5
_LOWEST_M = -2.0
_NEARLY = 0.99  # counts by correlation are a little off
_WORTH = 0.4  # of the overlap: with less after a few steps, fine ones lead to no rival


@dataclass(frozen=True)
class Plan:
    """What stands, by layers of height (layers, rows, columns), where anything was seen (rows, columns): spectra."""

    standing: NDArray[np.complex64]
    seen: NDArray[np.complex64]


def find_rivals(
    T_match_query: se3.Matrix4,
    query: OrientedPoints,
    match: OrientedPoints,
    config: VerificationConfig,
    *,
    repeats: bool = True,
) -> tuple[Hypothesis, ...]:
    """The poses other than `T_match_query` in which the surfaces overlap nearly as much, best first.

    A rival lies farther than `rival_distance` or 10 degrees away, its overlap is at least `rival_share` of that of
    `T_match_query`, and neither place has looked through more of the other than a loop may. Where there is none and
    `repeats`, the poses count by which both places repeat (docs/decisions/0340). Where there is one, other
    poses nearby that fit as well are told, too (docs/decisions/0080): they make no loop ambiguous by themselves.
    """
    search = _Search.around(T_match_query, query, match, config)
    far = _Rule(config.rival_distance, config.rival_reach, config.rival_share)
    ended = search.ended(propose(T_match_query, query, match, config), far)
    rivals = search.refined((), ended, far)
    if not rivals and repeats:
        rivals = search.repeating(ended, far)
    if rivals:
        near = _Rule(config.rival_nearest, config.rival_nearest, config.rival_near_share)
        rivals = search.refined(rivals, search.ended(search.nearby(), near), near)
    return tuple(sorted(rivals, key=lambda rival: -rival.overlap))


@dataclass(frozen=True)
class _Rule:
    """What makes a pose a rival: metres from all others, reach of the ICP that leads there, share of the overlap."""

    apart_m: float
    reach_m: float
    share: float


@dataclass(frozen=True)
class _Search:
    """The search for poses that explain two places as well as `best` does: `few` of their points tell."""

    best: se3.Matrix4
    query: OrientedPoints
    match: OrientedPoints
    few: tuple[OrientedPoints, OrientedPoints]
    config: VerificationConfig

    @classmethod
    def around(
        cls, best: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
    ) -> _Search:
        share = config.coarse_share
        few = query.kept(OrientedPoints.thinned, share), match.kept(OrientedPoints.thinned, share)
        return cls(best, query, match, few, config)

    def ended(self, proposed: list[se3.Matrix4], rule: _Rule) -> list[Hypothesis]:
        """Where a few steps of ICP lead from the `proposed` poses, apart from `best`."""
        poses = iterate_all(proposed, self.few[0], self.match, rule.reach_m, self.config.rival_rounds)
        return [
            Hypothesis(self._overlap(one), one) for one in poses if _apart(one, self.best, self.query, rule.apart_m)
        ]

    def refined(self, known: tuple[Hypothesis, ...], ended: list[Hypothesis], rule: _Rule) -> tuple[Hypothesis, ...]:
        """The `known` rivals, and those of the `ended` poses that are one by a rule."""
        rivals, config = list(known), self.config
        least = rule.share * self._overlap(self.best) if ended else 0.0
        for one in ended:
            if one.overlap < least or not self._new(one, rivals, rule):
                continue
            if mutually_seen_through(one.T_match_query, self.query, self.match, config) <= config.max_seen_through:
                rivals.append(one)
        return tuple(rivals)

    def repeating(self, ended: list[Hypothesis], rule: _Rule) -> tuple[Hypothesis, ...]:
        """The rivals among the `ended` poses, or more of them, to which leads a step by which both places repeat."""
        rivals, config = list[Hypothesis](), self.config
        if self.eased != 1.0:
            ended = self.ended(propose(self.best, self.query, self.match, config, self.eased), rule)
        least = self.eased * _WORTH * self._overlap(self.best) if ended else 0.0
        worth = [one for one in ended if one.overlap >= least]
        own = self.eased * overlap_beside(self.best, self.query, self.match, config) if worth else 0.0
        for one in worth:
            if self._new(one, rivals, rule):
                T_rival = iterate(one.T_match_query, self.query, self.match, config.fine_distance, config.fine_rounds)
                if self._repeats(T_rival, own):
                    rivals.append(Hypothesis(self._overlap(T_rival), T_rival))
        return tuple(rivals)

    def _new(self, one: Hypothesis, rivals: list[Hypothesis], rule: _Rule) -> bool:
        """Whether a pose is apart from all `rivals`."""
        return all(_apart(one.T_match_query, other.T_match_query, self.query, rule.apart_m) for other in rivals)

    @cached_property
    def eased(self) -> float:
        """The part of all shares that is asked for: less where both places were seen from the same spot."""
        shift_m, turn = np.linalg.norm(self.best[:3, 3]), np.degrees(se3.rotation_angle(self.best))
        return self.config.rival_same_spot if shift_m < 0.5 * self.config.spacing and turn < _SAME_TURN_DEG else 1.0

    def _repeats(self, T_rival: se3.Matrix4, own: float) -> bool:
        """Whether a pose explains enough beside an overlap `own`, and each place lies on itself a step on."""
        best, config = self.best, self.config
        placed = (T_rival @ se3.inverse(best), self.match), (se3.inverse(best) @ T_rival, self.query)
        return (
            overlap_beside(T_rival, self.query, self.match, config) >= config.rival_repeats_share * own
            and all(overlap_beside(T, one, one, config) >= config.rival_repeats * own for T, one in placed)
            and mutually_seen_through(T_rival, self.query, self.match, config) <= config.max_seen_through
        )

    def nearby(self) -> list[se3.Matrix4]:
        """Local maxima of the overlap over horizontal shifts of `best` by up to twice `rival_distance`, best first."""
        count = int(np.ceil(2.0 * self.config.rival_distance / _NEAR_STEP_M))
        along = np.arange(-count, count + 1) * _NEAR_STEP_M
        shifts = np.stack([*np.meshgrid(along, along), np.zeros((len(along), len(along)))], axis=-1).reshape(-1, 3)
        standing = self.few[0].standing.moved(self.best)
        shares = np.array(shared_shares(standing, self.match, shifts, self.config))
        plane = shares.reshape(len(along), len(along))
        peaks = np.flatnonzero((plane >= maximum_filter(plane, 3)) & (plane > 0.0))
        order = peaks[np.argsort(-shares[peaks], kind="stable")][: self.config.rival_starts]
        return [se3.from_yaw(0.0, tuple(shifts[row])) @ self.best for row in order]

    def _overlap(self, T_match_query: se3.Matrix4) -> float:
        return mean_overlap(T_match_query, self.query, self.match, self.few, self.config)


def propose(
    T_match_query: se3.Matrix4,
    query: OrientedPoints,
    match: OrientedPoints,
    config: VerificationConfig,
    eased: float = 1.0,
) -> list[se3.Matrix4]:
    """Poses at local maxima of the coarse overlap over shifts and quarter turns, best first; at most `rival_starts`.

    `eased`: the part of `rival_plan_share` that they must reach.
    """
    pixel, least = config.correlation_pixel, eased * config.rival_plan_share
    standing = se3.apply(T_match_query, query.standing.points)
    plans = _overlap_plans(standing, match.kept(_plan, pixel), least * config.rival_common, pixel)
    shares = plan_shares(plans.hits, plans.seen, config.rival_common * plans.seen[0, 0, 0])
    rows = _peaks(shares, least * shares[0, 0, 0], config.rival_distance / pixel)
    return [_shifted(T_match_query, plans.quarters[row], y, x, pixel) for row, y, x in rows[: config.rival_starts]]


def mean_overlap(
    T_match_query: se3.Matrix4,
    query: OrientedPoints,
    match: OrientedPoints,
    few: tuple[OrientedPoints, OrientedPoints],
    config: VerificationConfig,
) -> float:
    """The overlap of the standing surfaces, as `Evidence.overlap`, measured at a few points of either."""
    sides = ((few[0], match, T_match_query), (few[1], query, se3.inverse(T_match_query)))
    shares = []
    for some, other, T_other_some in sides:
        shares += shared_shares(some.standing.moved(T_other_some), other, np.zeros((1, 3)), config)
    return 0.5 * (shares[0] + shares[1])


@dataclass(frozen=True)
class _OverlapPlans:
    """For turns by `quarters` and every shift in pixels (q, y, x): how many points stand on what stands there, and how
    many were seen there. After half a turn a shift is one pixel more in x and y.
    """

    quarters: list[int]
    hits: Images
    seen: Images


def _overlap_plans(standing: Array64, against: Plan, least: float, pixel: float) -> _OverlapPlans:
    """The points `standing` (n, 3) on a plan. Plazas and crossings repeat by quarters, streets by half a turn.

    Turns in which no shift puts `least` times as many on what stands as no shift does are left out: a rival needs a
    share of the overlap and one of the common region, and so their product of what is hit.
    """
    spectra, totals = hit_products(against.standing, fft.rfft2(_layers(standing, pixel)))
    hits = fft.irfft2(spectra, s=(PLAN_SIZE, PLAN_SIZE))
    enough = _NEARLY * least * hits[0, 0, 0]
    quarters = [quarter for quarter in range(4) if quarter == 0 or hits[quarter].max() >= enough]
    seen = [against.seen * (totals[q % 2] if q >= 2 else np.conj(totals[q % 2])) for q in quarters]
    return _OverlapPlans(quarters, hits[quarters], fft.irfft2(np.stack(seen), s=(PLAN_SIZE, PLAN_SIZE)))


def _plan(surface: OrientedPoints, pixel: float) -> Plan:
    """The spectra of a place: its layers, one pixel wider so that close counts, and where it has seen, two wider."""
    points, standing = np.ascontiguousarray(surface.points), np.ascontiguousarray(surface.standing.points)
    layers = occupied_around(standing, pixel, PLAN_SIZE, _LAYERS, _LOWEST_M, _LAYER_M, 1)
    seen = occupied_around(points, pixel, PLAN_SIZE, 1, _LOWEST_M, _LAYER_M, 2)
    return Plan(fft.rfft2(layers), fft.rfft2(seen[0]))


def _layers(points: Array64, pixel: float) -> Images:
    """How many of `points` (n, 3) lie in each layer, row (y) and column (x) of a square around the origin."""
    points = np.ascontiguousarray(points)
    return np.asarray(layer_counts(points, pixel, PLAN_SIZE, _LAYERS, _LOWEST_M, _LAYER_M))


def _peaks(share: Images, least: float, apart: float) -> list[tuple[int, int, int]]:
    """Image, row and column of the local maxima of at least `least`, best first; in the first image, which is not
    turned, none within `apart` of no shift.
    """
    rows = plan_peaks(share, least, apart)
    order = np.argsort(-share[tuple(rows.T)], kind="stable")
    return [(int(q), int(y), int(x)) for q, y, x in rows[order]]


def _shifted(T_match_query: se3.Matrix4, quarter: int, row: int, column: int, pixel: float) -> se3.Matrix4:
    y, x = ((step + quarter // 2 + PLAN_SIZE // 2) % PLAN_SIZE - PLAN_SIZE // 2 for step in (row, column))
    return se3.from_yaw(quarter * np.pi / 2, (x * pixel, y * pixel, 0.0)) @ T_match_query


def _apart(one: se3.Matrix4, other: se3.Matrix4, query: OrientedPoints, distance_m: float) -> bool:
    """Whether two poses differ: in where they put the middle of the query, or in their turn."""
    middle = query.kept(_middle)
    if np.linalg.norm((one[:3, :3] - other[:3, :3]) @ middle + one[:3, 3] - other[:3, 3]) > distance_m:
        return True
    return float(np.degrees(se3.rotation_angle(se3.inverse(one) @ other))) > _TURN_APART_DEG


def _middle(query: OrientedPoints) -> Array64:
    """The mean (3,) of what stands."""
    return np.asarray(query.standing.points.mean(axis=0))


_TURN_APART_DEG = 10.0
_SAME_TURN_DEG = 3.0
