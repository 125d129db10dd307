"""Rivals of an alignment: other poses that explain the surfaces about as well (docs/decisions/0080).

Where a place repeats, the best pose is one of several. Rivals are sought on purpose: the overlap of the two places over
all shifts and four turns, by correlation of coarse layered plans, then a few ICP steps from its largest maxima.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification.evidence import in_region, mutually_seen_through
from revisit.core.verification.oriented_points import OrientedPoints, contact
from revisit.core.verification.registration import iterate

Array64 = NDArray[np.float64]
Images = NDArray[np.float32]

PLAN_SIZE = 128
"""Pixels along an edge of the plans."""

_LAYERS = 4
_LAYER_M = 1.5
_LOWEST_M = -2.0
_FEW_PEAKS = 0.1  # of the pixels: then they are looked at one by one
_TURNS = 4  # quarters: plazas and crossings repeat by them, streets by half a turn


@dataclass(frozen=True)
class Hypothesis:
    """A pose T_match_query (4, 4) of a pair, and the overlap 0..1 of the surfaces in it."""

    overlap: float
    T_match_query: se3.Matrix4


@dataclass(frozen=True)
class Plan:
    """What stands, by layers of height (layers, rows, columns), where anything was seen (rows, columns): spectra."""

    standing: NDArray[np.complex64]
    seen: NDArray[np.complex64]


def find_rivals(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> tuple[Hypothesis, ...]:
    """The poses other than `T_match_query` in which the surfaces overlap nearly as much, best first.

    A rival lies farther than `rival_distance` or 10 degrees away, its overlap is at least `rival_share` of that of
    `T_match_query`, and neither place has looked through more of the other than a loop may.
    """
    few = query.thinned(config.coarse_share), match.thinned(config.coarse_share)
    least = config.rival_share * mean_overlap(T_match_query, query, match, few, config)
    rivals: list[Hypothesis] = []
    for T_proposed in propose(T_match_query, query, match, config):
        T_rival = iterate(T_proposed, few[0], match, config.rival_reach, config.rival_rounds)
        if not all(
            _apart(T_rival, known, query, config) for known in (T_match_query, *(r.T_match_query for r in rivals))
        ):
            continue
        overlap = mean_overlap(T_rival, query, match, few, config)
        if overlap >= least and mutually_seen_through(T_rival, query, match, config) <= config.max_seen_through:
            rivals.append(Hypothesis(overlap, T_rival))
    return tuple(sorted(rivals, key=lambda rival: -rival.overlap))


def propose(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> list[se3.Matrix4]:
    """Poses at local maxima of the coarse overlap over shifts and quarter turns, best first; at most `rival_starts`."""
    pixel = config.correlation_pixel
    against = _plan(match, pixel)
    shares, commons = [], []
    for quarter in range(_TURNS):
        moved = query.moved(se3.from_yaw(quarter * np.pi / 2) @ T_match_query)
        share, common = _overlap_surface(moved, against, pixel)
        shares.append(share)
        commons.append(common)
    share, common = np.stack(shares), np.stack(commons)
    share[common < config.rival_common * common[0, 0, 0]] = 0.0
    rows = _peaks(share, config.rival_plan_share * share[0, 0, 0], config.rival_distance / pixel)
    return [_shifted(T_match_query, *row, pixel) for row in rows[: config.rival_starts]]


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
        moved = some.standing.moved(T_other_some)
        seen = in_region(moved, other)
        shares.append(float((contact(moved, other, config).touching & seen).sum()) / max(int(seen.sum()), 1))
    return 0.5 * (shares[0] + shares[1])


def _overlap_surface(moved: OrientedPoints, against: Plan, pixel: float) -> tuple[Images, Images]:
    """For every shift in pixels, the share of `moved` that stands on what stands there, and how much was seen there."""
    layers = fft.rfft2(_layers(moved.standing, pixel))
    shape = (PLAN_SIZE, PLAN_SIZE)
    hits = fft.irfft2((against.standing * layers.conj()).sum(axis=0), s=shape)
    seen = fft.irfft2(against.seen * layers.sum(axis=0).conj(), s=shape)
    return np.asarray(hits / np.maximum(seen, 1.0)), np.asarray(seen)


def _plan(surface: OrientedPoints, pixel: float) -> Plan:
    """The spectra of a place: its layers, one pixel wider so that close counts, and where it has seen."""
    standing = _wider((_layers(surface.standing, pixel) > 0).astype(np.float32))
    seen = (_layers(surface, pixel).sum(axis=0, keepdims=True) > 0).astype(np.float32)
    return Plan(fft.rfft2(standing), fft.rfft2(_wider(_wider(seen)))[0])


def _layers(surface: OrientedPoints, pixel: float) -> Images:
    """How many points lie in each layer, row (y) and column (x) of a square around the origin."""
    cells = np.floor(surface.points[:, :2] / pixel).astype(np.int64) + PLAN_SIZE // 2
    inside = ((cells >= 0) & (cells < PLAN_SIZE)).all(axis=1)
    layer = np.clip((surface.points[inside, 2] - _LOWEST_M) / _LAYER_M, 0, _LAYERS - 1).astype(np.int64)
    flat = (layer * PLAN_SIZE + cells[inside, 1]) * PLAN_SIZE + cells[inside, 0]
    counts = np.bincount(flat, minlength=_LAYERS * PLAN_SIZE**2)
    return counts.astype(np.float32).reshape(_LAYERS, PLAN_SIZE, PLAN_SIZE)


def _wider(images: Images) -> Images:
    """The largest value of each pixel and its eight neighbours; the edges go round."""
    along = np.maximum(np.maximum(np.roll(images, 1, -1), images), np.roll(images, -1, -1))
    return np.asarray(np.maximum(np.maximum(np.roll(along, 1, -2), along), np.roll(along, -1, -2)))


def _peaks(share: Images, least: float, apart: float) -> list[tuple[int, int, int]]:
    """Quarter, row and column of the local maxima of at least `least`, best first; none within `apart` of no shift."""
    peak = share >= least
    if peak.sum() < _FEW_PEAKS * peak.size:
        peak[peak] = _highest_around(share, np.argwhere(peak))
    else:
        peak &= share >= _wider(share)
    steps = np.minimum(np.arange(PLAN_SIZE), PLAN_SIZE - np.arange(PLAN_SIZE))
    peak[0] &= np.hypot(steps[:, None], steps[None, :]) >= apart
    rows = np.argwhere(peak)
    order = np.argsort(-share[tuple(rows.T)], kind="stable")
    return [(int(q), int(y), int(x)) for q, y, x in rows[order]]


def _highest_around(share: Images, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the pixels `rows` (n, 3) are at least as high as their eight neighbours; the edges go round."""
    quarter, y, x = rows.T
    here = share[quarter, y, x]
    highest = np.ones(len(rows), dtype=bool)
    for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        highest &= here >= share[quarter, (y + dy) % PLAN_SIZE, (x + dx) % PLAN_SIZE]
    return np.asarray(highest)


def _shifted(T_match_query: se3.Matrix4, quarter: int, row: int, column: int, pixel: float) -> se3.Matrix4:
    y, x = ((step + PLAN_SIZE // 2) % PLAN_SIZE - PLAN_SIZE // 2 for step in (row, column))
    return se3.from_yaw(quarter * np.pi / 2, (x * pixel, y * pixel, 0.0)) @ T_match_query


def _apart(one: se3.Matrix4, other: se3.Matrix4, query: OrientedPoints, config: VerificationConfig) -> bool:
    """Whether two poses differ: in where they put the middle of the query, or in their turn."""
    middle = query.standing.points.mean(axis=0)[None]
    if np.linalg.norm(se3.apply(one, middle) - se3.apply(other, middle)) > config.rival_distance:
        return True
    return float(np.degrees(se3.rotation_angle(se3.inverse(one) @ other))) > _TURN_APART_DEG


_TURN_APART_DEG = 10.0
