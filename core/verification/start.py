"""Where the registration of two places starts: planar poses from keypoints and images, lifted to the right height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import map_coordinates

from revisit.core.config import VerificationConfig
from revisit.core.correspondences import correspond
from revisit.core.geometry import se3
from revisit.core.geometry.se2 import PlanarPose, turned
from revisit.core.place import Place
from revisit.core.verification.keypoint_fit import KeypointFit, fit_planar_pose
from revisit.core.verification.oriented_points import columns_of

Array64 = NDArray[np.float64]

IMAGE_SIZE = 128
"""Pixels along an edge of the images for phase correlation."""

_HALF = IMAGE_SIZE // 2
_ANGLES = 180  # steps of the polar amplitude, 1 degree each
_RADII = (3.0, 45.0)  # of the polar amplitude: below is the mean density, above is noise
_TURN_APART = 8  # degrees between two turns that are tried
_MOST_TURNS = 6


@dataclass(frozen=True)
class Start:
    """The fit of the keypoints, and the poses T_match_query (4, 4) from which registration starts, likeliest first."""

    fit: KeypointFit
    poses: tuple[se3.Matrix4, ...]


def find_start(query: Place, match: Place, config: VerificationConfig) -> Start:
    """The pose of the keypoints and, where too few of them agree, those of phase correlation; at most `starts`."""
    fit = fit_planar_pose(correspond(query, match, config.correspondences), config)
    planar = [fit.pose] if fit.inliers >= config.sure_inliers else [fit.pose, *correlate(query, match, config)]
    return Start(fit, tuple(lift(pose, query, match) for pose in planar[: config.starts]))


def correlate(query: Place, match: Place, config: VerificationConfig) -> list[PlanarPose]:
    """Planar poses by phase correlation of coarse images of what stands, most similar first.

    The amplitude spectra do not depend on the translation and give the yaw up to 180 degrees. For both directions the
    translation then follows by correlation.
    """
    match_image = raster(_standing_plan(match), config.correlation_pixel)
    match_spectrum = fft.rfft2(match_image)
    query_points = _standing_plan(query)
    query_spectrum = fft.fft2(raster(query_points, config.correlation_pixel))
    turns = _likely_turns(_polar_amplitude(query_spectrum), _polar_amplitude(fft.fft2(match_image)))
    fits = []
    for turn in turns[: config.correlation_turns]:
        for yaw in (turn, turn + np.pi):
            image = raster(turned(query_points, yaw), config.correlation_pixel)
            peak, shift = _best_shift(image, match_spectrum)
            norm = float(np.linalg.norm(image) * np.linalg.norm(match_image))
            fits.append((peak / max(norm, 1e-12), PlanarPose(float(yaw), shift * config.correlation_pixel)))
    fits.sort(key=lambda fit: -fit[0])
    return [pose for _, pose in fits]


def lift(pose: PlanarPose, query: Place, match: Place) -> se3.Matrix4:
    """The planar pose in space (4, 4), raised by the median height difference of the ground that both have seen.

    The ground of a column is its lowest point. Where the places share no column the height is 0.
    """
    flat = pose.lifted()
    match_columns, match_heights = _lowest(match.points.astype(np.float64))
    query_columns, query_heights = _lowest(se3.apply(flat, query.points))
    shared, rows, columns = np.intersect1d(match_columns, query_columns, return_indices=True)
    if len(shared) == 0:
        return flat
    return pose.lifted(float(np.median(match_heights[rows] - query_heights[columns])))


def raster(points: Array64, pixel: float) -> Array64:
    """The density of `points` (n, 2) as an image around the origin, smoothed and free of its mean.

    Rows are y, columns x, `pixel` metres wide. Points outside the image are left out.
    """
    cells = np.floor(points / pixel).astype(np.int64) + _HALF
    inside = ((cells >= 0) & (cells < IMAGE_SIZE)).all(axis=1)
    flat = cells[inside, 1] * IMAGE_SIZE + cells[inside, 0]
    counts = np.bincount(flat, minlength=IMAGE_SIZE * IMAGE_SIZE).astype(np.float64)
    image = np.log1p(counts).reshape(IMAGE_SIZE, IMAGE_SIZE)
    image = image + 0.5 * (np.roll(image, 1, 0) + np.roll(image, -1, 0) + np.roll(image, 1, 1) + np.roll(image, -1, 1))
    return np.asarray(image - image.mean())


def _standing_plan(place: Place) -> Array64:
    """What stands in a place, seen from above (n, 2)."""
    return place.points[: place.standing_count, :2].astype(np.float64)


def _best_shift(image: Array64, match_spectrum: NDArray[np.complex128]) -> tuple[float, Array64]:
    """The largest correlation of `image` with the match, and the shift (x, y) in pixels that gives it."""
    surface = fft.irfft2(match_spectrum * np.conj(fft.rfft2(image)), s=image.shape)
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    shift = (np.array([column, row], dtype=np.float64) + _HALF) % IMAGE_SIZE - _HALF
    return float(surface[row, column]), shift


def _polar_amplitude(spectrum: NDArray[np.complex128]) -> Array64:
    """The amplitude of a spectrum over angle (rows of 1 degree) and radius, each ring free of its mean."""
    amplitude = np.log1p(np.abs(fft.fftshift(spectrum)))
    angle = np.radians(np.arange(float(_ANGLES)))[:, None]
    radius = np.arange(*_RADII)[None, :]
    polar = map_coordinates(amplitude, [_HALF + radius * np.sin(angle), _HALF + radius * np.cos(angle)], order=1)
    return np.asarray(polar - polar.mean(axis=0))


def _likely_turns(query: Array64, match: Array64) -> list[float]:
    """Yaws of T_match_query in [0, pi) radians where the polar amplitudes agree, best first, well apart."""
    product = fft.fft(match, axis=0) * np.conj(fft.fft(query, axis=0))
    agreement = fft.ifft(product, axis=0).real.sum(axis=1)
    turns: list[int] = []
    for turn in np.argsort(-agreement, kind="stable"):
        if all(min(abs(turn - other), _ANGLES - abs(turn - other)) >= _TURN_APART for other in turns):
            turns.append(int(turn))
        if len(turns) == _MOST_TURNS:
            break
    return [float(np.radians(turn)) for turn in turns]


def _lowest(points: Array64) -> tuple[NDArray[np.int64], Array64]:
    """The columns that `points` (n, 3) occupy and the lowest height in each, metres."""
    keys = columns_of(points)
    order = np.lexsort((points[:, 2], keys))
    columns, first = np.unique(keys[order], return_index=True)
    return columns, points[order][first, 2]
