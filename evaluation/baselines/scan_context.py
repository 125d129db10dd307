"""Scan Context (Kim and Kim, IROS 2018): highest point per ring and sector; columns are shifted to undo yaw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor


@dataclass(frozen=True)
class ScanContext:
    """Polar grid of `rings` x `sectors` to `max_range_m`; `sensor_height_m` lifts heights above zero (paper: 2 m).

    `ring_key_candidates` places with the nearest ring keys are compared in full, as in the paper; None compares all.
    """

    rings: int = 20
    sectors: int = 60
    max_range_m: float = 80.0
    sensor_height_m: float = 2.0
    ring_key_candidates: int | None = 50

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "scan-context"

    def describe(self, points: Points) -> Descriptor:
        """Greatest height of every ring and sector (rings, sectors); 0 where nothing was seen."""
        radius = np.hypot(points[:, 0], points[:, 1])
        inside = radius < self.max_range_m
        ring = (radius[inside] / self.max_range_m * self.rings).astype(np.int64)
        turn = np.mod(np.arctan2(points[inside, 1], points[inside, 0]), 2 * np.pi) / (2 * np.pi)
        sector = np.minimum((turn * self.sectors).astype(np.int64), self.sectors - 1)
        context = np.zeros((self.rings, self.sectors), dtype=np.float32)
        np.maximum.at(context, (ring, sector), points[inside, 2] + np.float32(self.sensor_height_m))
        return context

    def similarities(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.float64]:
        """1 - distance of the best column shift for the candidates of the ring key, -1 for the others."""
        result = np.full(len(places), -1.0)
        chosen = self._candidates(query, places)
        result[chosen] = self._best_shift(query, places[chosen]).max(axis=1)
        return result

    def yaw_shift(self, query: Descriptor, place: Descriptor) -> int:
        """How many sectors the query must be turned forward to look like the place."""
        return int(self._best_shift(query, place[None])[0].argmax())

    def _candidates(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.int64]:
        if self.ring_key_candidates is None or self.ring_key_candidates >= len(places):
            return np.arange(len(places))
        keys = (places > 0).mean(axis=2)
        distance = np.linalg.norm(keys - (query > 0).mean(axis=1), axis=1)
        return np.argsort(distance, kind="stable")[: self.ring_key_candidates]

    def _best_shift(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.float64]:
        """Mean cosine between the columns of the shifted query and the places, (m, shifts)."""
        shifts = np.stack([np.roll(query, shift, axis=1) for shift in range(self.sectors)])
        query_unit, query_seen = _unit_columns(shifts)
        place_unit, place_seen = _unit_columns(places)
        # Columns empty on either side say nothing: the mean runs over columns both have seen.
        both = np.einsum("sc,mc->ms", query_seen, place_seen)
        return np.asarray(np.einsum("src,mrc->ms", query_unit, place_unit, optimize=True) / np.maximum(both, 1.0))


def _unit_columns(contexts: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contexts (m, rings, sectors) with columns of length 1, and which columns are not empty (m, sectors)."""
    length = np.linalg.norm(contexts, axis=1)
    unit = contexts / np.maximum(length, 1e-9)[:, None]
    return unit.astype(np.float64), (length > 0).astype(np.float64)
