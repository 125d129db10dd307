"""LiDAR-Iris (Wang et al., IROS 2020): a polar image of occupied heights, log-Gabor phase as bits, Hamming distance.

The image has one row a ring and one column a degree; a pixel's eight bits say in which height slices something stands.
Yaw is a shift of columns: the cross-correlation of the images gives it, and the bits are compared around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class LidarIris:
    """`rings` x `columns` pixels to `max_range_m`; heights between `lowest_m` and `highest_m` of the sensor.

    `scales` log-Gabor filters, the first `wavelength` columns long, each `factor` times the one before, of relative
    bandwidth `sigma`. Compared are `search` columns around the shift of the correlation. `key_candidates` places whose
    rings are filled most alike are compared in full (the paper compares all: None).
    """

    rings: int = 80
    columns: int = 360
    max_range_m: float = 80.0
    lowest_m: float = -3.0
    highest_m: float = 5.0
    scales: int = 4
    wavelength: float = 18.0
    factor: float = 1.6
    sigma: float = 0.75
    search: int = 2
    key_candidates: int | None = 50

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "lidar-iris"

    def describe(self, points: Points) -> Descriptor:
        """(rings + code rows + mask rows, columns) uint8: image, then the phase code and its mask, packed."""
        image = self._image(points)
        code, mask = self._code(image)
        return np.concatenate([image, np.packbits(code, axis=0), np.packbits(mask, axis=0)])

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """1 - least share of differing bits among the shifts tried; -1 for places that the key leaves out."""
        result = np.full(len(places), -1.0)
        shifts = np.arange(-self.search, self.search + 1)
        for index in self._candidates(query, places):
            best = self.yaw_shift(query, places[index])
            distance = [self._distance(np.roll(query, best + shift, axis=1), places[index]) for shift in shifts]
            result[index] = 1.0 - min(distance)
        return result

    def yaw_shift(self, query: Descriptor, place: Descriptor) -> int:
        """How many columns (degrees) the query must be turned forward to look like the place."""
        asked, known = query[: self.rings].astype(np.float64), place[: self.rings].astype(np.float64)
        product = np.conj(np.fft.rfft(asked, axis=1)) * np.fft.rfft(known, axis=1)
        return int(np.fft.irfft(product.sum(axis=0), n=self.columns).argmax())

    @cached_property
    def _filters(self) -> NDArray[np.float64]:
        """Transfer functions (scales, columns): log-normal around each centre, positive frequencies only."""
        frequency = np.fft.fftfreq(self.columns)
        centres = 1.0 / (self.wavelength * self.factor ** np.arange(self.scales))
        response = np.zeros((self.scales, self.columns))
        positive = frequency > 0
        ratio = np.log(frequency[positive][None] / centres[:, None])
        response[:, positive] = np.exp(-(ratio**2) / (2 * np.log(self.sigma) ** 2))
        return response

    def _image(self, points: Points) -> Bytes:
        radius = np.hypot(points[:, 0], points[:, 1])
        inside = (radius < self.max_range_m) & (points[:, 2] >= self.lowest_m) & (points[:, 2] < self.highest_m)
        ring = (radius[inside] / self.max_range_m * self.rings).astype(np.int64)
        turn = np.mod(np.arctan2(points[inside, 1], points[inside, 0]), 2 * np.pi) / (2 * np.pi)
        column = np.minimum((turn * self.columns).astype(np.int64), self.columns - 1)
        height = (points[inside, 2] - self.lowest_m) / (self.highest_m - self.lowest_m)
        level = np.clip((height * 8).astype(np.int64), 0, 7)
        image = np.zeros((self.rings, self.columns), dtype=np.uint8)
        np.bitwise_or.at(image, (ring, column), np.left_shift(1, level).astype(np.uint8))
        return image

    def _code(self, image: Bytes) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Bits (2 scales rings, columns): the signs of the filtered rings, and where they mean anything."""
        spectrum = np.fft.fft(image.astype(np.float64), axis=1)
        filtered = np.fft.ifft(spectrum[None] * self._filters[:, None], axis=2).reshape(-1, self.columns)
        code = np.concatenate([filtered.real > 0, filtered.imag > 0])
        weak = np.abs(filtered) < 1e-4
        return code, ~np.concatenate([weak, weak])

    def _candidates(self, query: Descriptor, places: Descriptor) -> NDArray[np.int64]:
        if self.key_candidates is None or self.key_candidates >= len(places):
            return np.arange(len(places))
        keys = (places[:, : self.rings] > 0).mean(axis=2)
        distance = np.linalg.norm(keys - (query[: self.rings] > 0).mean(axis=1), axis=1)
        return np.argsort(distance, kind="stable")[: self.key_candidates]

    def _distance(self, first: Bytes, second: Bytes) -> float:
        """Share of the bits that differ among those that mean something in both; 1 where there are none."""
        start = self.rings + (len(first) - self.rings) // 2
        both = first[start:] & second[start:]
        compared = int(np.bitwise_count(both).sum())
        differing = int(np.bitwise_count((first[self.rings : start] ^ second[self.rings : start]) & both).sum())
        return differing / compared if compared else 1.0
