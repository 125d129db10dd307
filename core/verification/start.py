"""Where the registration of two places starts: planar poses from keypoints and images, lifted to the right height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se2 import PlanarPose
from revisit.core.kernels.plan_images import plan_density
from revisit.core.kernels.seen_columns import heights_above
from revisit.core.place import Place
from revisit.core.place.correspondences import correspond
from revisit.core.verification.keypoint_fit import KeypointFit, fit_of_pose, fit_planar_pose
from revisit.core.verification.oriented_points import COLUMN_M, OrientedPoints
from revisit.core.verification.phase_correlation import Agreement, agreements

Array64 = NDArray[np.float64]
Spectrum = NDArray[np.complexfloating]

IMAGE_SIZE = 128
"""Pixels along an edge of the images for phase correlation."""

_HALF = IMAGE_SIZE // 2
_ANGLES = 180  # steps of the polar amplitude, 1 degree each
_RADII = (3.0, 45.0)  # of the polar amplitude: below is the mean density, above is noise
_TURN_APART = 8  # degrees between two turns that are tried
_NEARLY_OPPOSITE = 0.999  # the two directions of a turn lie half a turn apart but for rounding


@dataclass(frozen=True)
class Start:
    """The fit of the keypoints, and the poses T_match_query (4, 4) from which registration starts, likeliest first."""

    fit: KeypointFit
    poses: tuple[se3.Matrix4, ...]


def find_start(query: Place, match: Place, config: VerificationConfig) -> Start:
    """The pose of the keypoints and, where too few of them agree, those of phase correlation; at most `starts`.

    One more where two opposite directions fit alike: see `_undecided`.
    """
    fit = fit_planar_pose(correspond(query, match, config.correspondences), config)
    if fit.inliers >= config.sure_inliers:
        return Start(fit, (lift(fit.pose, query, match),))
    fits = _fits(query, match, config)
    most = config.starts + int(config.starts > 1 and _undecided(fits, config))
    planar = [fit.pose, *_planar(fits, config)][:most]
    return Start(fit, tuple(lift(pose, query, match) for pose in planar))


def start_at(T_match_query: se3.Matrix4, query: Place, match: Place, config: VerificationConfig) -> Start:
    """A pose that is known otherwise, in the level frames, as the only one; the fit tells how many keypoints agree."""
    planar = PlanarPose(float(np.arctan2(T_match_query[1, 0], T_match_query[0, 0])), T_match_query[:2, 3])
    return Start(fit_of_pose(planar, correspond(query, match, config.correspondences), config), (T_match_query,))


def correlate(query: Place, match: Place, config: VerificationConfig) -> list[PlanarPose]:
    """Planar poses by phase correlation of coarse images of the structure, most similar first.

    The amplitude spectra do not depend on the translation and give the yaw up to 180 degrees. For both directions the
    translation then follows by correlation.
    """
    return _planar(_fits(query, match, config), config)


def _planar(fits: Sequence[Agreement], config: VerificationConfig) -> list[PlanarPose]:
    return [PlanarPose(fit.yaw, fit.shift * config.correlation_pixel) for fit in fits]


def _fits(query: Place, match: Place, config: VerificationConfig) -> list[Agreement]:
    """How well the images fit in either direction of each turn, best first."""
    pixel, points = config.correlation_pixel, query.kept(_standing_plan)
    of_query, of_match = query.kept(_seen_from_above, pixel), match.kept(_seen_from_above, pixel)
    turns = _likely_turns(of_query.polar, of_match.polar, config.correlation_turns)
    fits = agreements(points, turns, of_match.spectrum, pixel)
    return sorted(fits, key=lambda fit: -fit.peak)


def _undecided(fits: Sequence[Agreement], config: VerificationConfig) -> bool:
    """Whether the best two of `fits` are the two directions of one turn that nothing else comes near: rows of one kind.

    Then the image tells the turn, but not which end is which (docs/decisions/0024).
    """
    if len(fits) < 3:
        return False
    first, second, third = fits[:3]
    alike = second.peak >= config.opposite_share * first.peak
    return alike and third.peak <= config.opposite_clear * first.peak and _are_opposite(first.yaw, second.yaw)


def _are_opposite(one: float, other: float) -> bool:
    return float(np.cos(one - other)) < -_NEARLY_OPPOSITE


@dataclass(frozen=True)
class SeenFromAbove:
    """The structure of a place as an image: its spectrum, and that over angle (91, radii) of its polar amplitude."""

    spectrum: NDArray[np.complex64]
    polar: NDArray[np.complex128]


def _seen_from_above(place: Place, pixel: float) -> SeenFromAbove:
    spectrum = fft.rfft2(raster(place.kept(_standing_plan), pixel))
    polar = fft.rfft(polar_amplitude(spectrum), axis=0)
    return SeenFromAbove(spectrum.astype(np.complex64), polar)


def lift(pose: PlanarPose, query: Place, match: Place) -> se3.Matrix4:
    """The planar pose in space (4, 4), raised by the median height difference of the ground that both have seen.

    The ground of a column is its lowest point. Where the places share no column the height is 0.
    """
    flat, seen = pose.lifted(), OrientedPoints.of(match).seen
    rises = heights_above(OrientedPoints.of(query).points, flat, seen, COLUMN_M)
    return pose.lifted(float(np.median(rises))) if len(rises) else flat


def raster(points: Array64, pixel: float, yaw: float = 0.0) -> Array64:
    """The density of `points` (n, 2), turned by `yaw` radians, as an image around the origin, smoothed and free of its
    mean.

    Rows are y, columns x, `pixel` metres wide. Points outside the image are left out.
    """
    return np.asarray(plan_density(points, yaw, pixel, IMAGE_SIZE))


def _standing_plan(place: Place) -> Array64:
    """The standing structure of a place, seen from above (n, 2)."""
    return np.ascontiguousarray(place.points[: place.standing_count, :2].astype(np.float64))


def polar_amplitude(spectrum: NDArray[np.complex128]) -> Array64:
    """The amplitude over angle (rows of 1 degree) and radius, each ring free of its mean.

    Takes the half of the spectrum of a real image in which columns count from 0: the other half mirrors it.
    """
    pixels, near, weights = _polar_pixels()
    amplitude = np.log1p(np.abs(spectrum.ravel()[pixels]))
    polar = np.einsum("kar,kar->ar", amplitude[near], weights)
    return np.asarray(polar - polar.mean(axis=0))


@cache
def _polar_pixels() -> tuple[NDArray[np.intp], NDArray[np.intp], Array64]:
    """The pixels (p,) of half a spectrum that the polar amplitude is made of; which four of them lie around each angle
    and radius (4, angles, radii), and their linear weights.
    """
    angle = np.radians(np.arange(float(_ANGLES)))[:, None]
    radius = np.arange(*_RADII)[None, :]
    row, column = radius * np.sin(angle), radius * np.cos(angle)
    first_row, first_column = np.floor(row), np.floor(column)
    near, weights = [], []
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        y, x = (first_row + down).astype(np.intp), (first_column + right).astype(np.intp)
        mirrored = np.where(x < 0, -1, 1)
        near.append((mirrored * y) % IMAGE_SIZE * (_HALF + 1) + mirrored * x)
        weights.append((1.0 - np.abs(row - y)) * (1.0 - np.abs(column - x)))
    pixels, places = np.unique(np.stack(near), return_inverse=True)
    return pixels, places.reshape(4, _ANGLES, -1), np.stack(weights)


def _likely_turns(query: NDArray[np.complex128], match: NDArray[np.complex128], most: int) -> list[float]:
    """Yaws of T_match_query in [0, pi) radians where the polar amplitudes agree, well apart: the `most` best, in order.

    Takes the spectra of the amplitudes over angle.
    """
    agreement = fft.irfft((match * np.conj(query)).sum(axis=1), n=_ANGLES)
    turns: list[int] = []
    for turn in np.argsort(-agreement, kind="stable").tolist():
        if all(min(abs(turn - other), _ANGLES - abs(turn - other)) >= _TURN_APART for other in turns):
            turns.append(turn)
        if len(turns) == most:
            break
    return [float(np.radians(turn)) for turn in turns]
