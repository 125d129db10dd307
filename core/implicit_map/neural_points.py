"""Elastic neural points (paper III-B 1 and 3, Eq. 1): insertion, movement, orientation.

A neural point m = (p, q, f, t_c, t_u, mu) lives in one voxel. Its position follows the mean of the returns seen there,
its orientation q turns the local z axis to the surface normal on the side of the sensor, so that the decoder sees the
surface in a frame of its own (Eq. 2) whatever the heading of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.elastic_points import FIRST_SCAN, VIEW, pooled_covariances
from revisit.core.kernels.oriented_normals import oriented_normals
from revisit.core.kernels.point_columns import columns_of

Array = NDArray[np.float32]

MAX_NEURAL_POINTS = 4_000_000
"""As many as a cloud of the largest size can have."""


@dataclass(frozen=True)
class NeuralPoints:  # Eq. 1
    """The points of one submap, Eq. 1 without the latent features.

    positions (n, 3) and normals (n, 3) float32; created and updated (n,) int32, the scans of t_c and t_u;
    hits (n,) int32, scans that saw a return here; stability (n,) float32, mu.
    """

    positions: Array
    normals: Array
    created: NDArray[np.int32]
    updated: NDArray[np.int32]
    hits: NDArray[np.int32]
    stability: Array

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> NeuralPoints:
        """Only the points where `keep` (n,) holds, or those of the rows `keep` (m,)."""
        rows = np.flatnonzero(keep) if keep.dtype == np.bool_ else keep
        return NeuralPoints(
            self.positions.take(rows, axis=0), self.normals.take(rows, axis=0), self.created[rows], self.updated[rows],
            self.hits[rows], self.stability[rows],
        )  # fmt: skip

    @classmethod
    def remembered(cls, positions: Array, normals: Array, hits: NDArray[np.int32], scans: int) -> NeuralPoints:
        """Points read from a store, which keeps no times: each seen from the first to the last of so many scans."""
        created, updated = np.zeros(len(positions), np.int32), np.full(len(positions), scans - 1, np.int32)
        return cls(positions, normals, created, updated, hits, hits.astype(np.float32))


def oriented(gathered: NDArray[np.float64], resolution: float, most: int = MAX_NEURAL_POINTS) -> NeuralPoints:
    """The neural points of the returns `gathered` in voxels, records (n, RECORD), with their orientations.

    Each lies at the mean of the returns in its voxel, the first of which created it (paper III-B 3; why none is ever
    evicted: docs/decisions/0063). Of more than `most` those nearest to the middle.
    """
    positions, records = (gathered[:, 1:4] / gathered[:, :1]).astype(np.float32), gathered
    everywhere = columns_of(positions, resolution)
    if len(positions) > most:
        rows = nearest_to_middle(positions, most)
        positions, records = positions[rows], records[rows]
    scans = records[:, FIRST_SCAN:].astype(np.int32)
    spreads = pooled_covariances(positions, gathered, everywhere, resolution)
    normals = oriented_normals(spreads, records[:, VIEW])
    return NeuralPoints(
        positions=positions, normals=normals, created=scans[:, 0].copy(), updated=scans[:, 1].copy(),
        hits=scans[:, 2].copy(), stability=scans[:, 2].astype(np.float32),
    )  # fmt: skip


def nearest_to_middle(positions: Array, most: int) -> NDArray[np.int64]:
    """The rows, ascending, of at most so many of `positions` (n, 3): those nearest to the middle of the submap."""
    if len(positions) <= most:
        return np.arange(len(positions))
    squared = np.einsum("ij,ij->i", positions, positions)
    return np.sort(np.argpartition(squared, most)[:most])
