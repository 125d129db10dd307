"""Keypoints of the BEV image, their orientation, and histograms of the rotated patch around each (paper III-D)."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from revisit.core.bev.log_gabor import OrientationMap
from revisit.core.config import BevConfig, KeypointSource
from revisit.core.kernels.patch_histograms import disc_histograms, patch_histograms

Array = NDArray[np.float32]
Pixels = NDArray[np.int64]


def detect_keypoints(image: Array, orientation_map: OrientationMap, config: BevConfig) -> Pixels:
    """The strongest FAST corners (n, 2) as (column, row), at most `max_keypoints`, strongest first.

    Sought on the BEV image, or on the maximum index map as the paper says (`keypoint_source`). A scene with fewer than
    `min_keypoints` corners is filled up with the local maxima of the filter amplitude.
    """
    canvas = image * 255.0
    if config.keypoint_source is KeypointSource.MIM:
        canvas = orientation_map.index * (255.0 / orientation_map.orientations)
    detector = cv2.FastFeatureDetector.create(threshold=config.fast_threshold, nonmaxSuppression=True)
    corners = detector.detect(np.ascontiguousarray(canvas, dtype=np.uint8))
    pixels = np.array([corner.pt for corner in corners], dtype=np.int64).reshape(-1, 2)
    strength = np.array([corner.response for corner in corners])
    pixels = pixels[np.lexsort((pixels[:, 0], pixels[:, 1], -strength))]
    if len(pixels) < config.min_keypoints:
        pixels = np.concatenate([pixels, amplitude_peaks(orientation_map.amplitude)])
        _, first = np.unique(pixels, axis=0, return_index=True)
        pixels = pixels[np.sort(first)][: config.min_keypoints]
    return np.asarray(pixels[: config.max_keypoints])


def amplitude_peaks(amplitude: Array) -> Pixels:
    """The local maxima (n, 2) of the filter amplitude as (column, row), strongest first."""
    highest = cv2.dilate(amplitude, np.ones((5, 5), np.uint8))
    rows, columns = np.nonzero((amplitude == highest) & (amplitude > 0.1 * amplitude.max()))
    order = np.argsort(-amplitude[rows, columns], kind="stable")
    return np.stack([columns, rows], axis=1)[order].astype(np.int64)


def context_histograms(orientation_map: OrientationMap, pixels: Pixels, config: BevConfig) -> Array:
    """Orientation histograms (n, orientations) of the disc of `context_px` around each keypoint.

    A pixel at the share rho of the disc's radius counts with (1 - rho)^2 times its filter amplitude (method notes).
    """
    orientation = np.arange(orientation_map.orientations)[:, None, None]
    layers = np.where(orientation_map.index == orientation, orientation_map.amplitude, np.float32(0.0))
    return np.asarray(disc_histograms(layers, pixels, _fading_disc(config.context_px // 2)))


@lru_cache(maxsize=4)
def _fading_disc(radius: int) -> Array:
    """Weights (2 * radius + 1, the same) that fall from 1 in the middle to 0 at the radius."""
    offset = np.arange(-radius, radius + 1)
    disc = np.clip(1.0 - np.hypot(offset[:, None], offset[None, :]) / radius, 0.0, None) ** 2
    return np.asarray(disc, dtype=np.float32)


def dominant_orientations(histograms: Array) -> Array:
    """The peak (n,) of circular histograms (n, bins) over pi, by a parabola through three bins; radians in [0, pi)."""
    count, bins = histograms.shape
    rows, peak = np.arange(count), histograms.argmax(axis=1)
    before, at, after = (histograms[rows, (peak + step) % bins] for step in (-1, 0, 1))
    curvature = before - 2.0 * at + after
    shift = np.where(curvature < -1e-12, 0.5 * (before - after) / np.minimum(curvature, -1e-12), 0.0)
    return np.asarray((peak + shift) * np.pi / bins % np.pi, dtype=np.float32)


def describe_patches(orientation_map: OrientationMap, pixels: Pixels, angles: Array, config: BevConfig) -> Array:
    """Patch histograms (n, cells * cells * orientations), Hellinger mapped: L1 norm, then square root; unit L2 norm.

    The patch of `patch_px` is rotated by the keypoint's angle; in each of cells x cells parts the orientations,
    relative to that angle, are counted with the power `amplitude_power` of the filter amplitude. Layout: cell row,
    cell column, orientation.
    """
    weights = orientation_map.amplitude**config.amplitude_power
    weights[orientation_map.amplitude < 0.02 * orientation_map.amplitude.max(initial=0.0)] = 0.0
    form = config.patch_px, config.patch_step, config.cells, orientation_map.orientations
    histograms = patch_histograms(orientation_map.index, weights, pixels, angles, *form)
    total = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-12)
    return np.asarray(np.sqrt(histograms / total), dtype=np.float32)


def reversed_patches(descriptors: Array, cells: int) -> Array:
    """The descriptors (n, d) that the same patches have when turned by 180 degrees."""
    grid = descriptors.reshape(len(descriptors), cells, cells, -1)
    return np.ascontiguousarray(grid[:, ::-1, ::-1]).reshape(descriptors.shape)
