"""BEV keypoints weigh and schedule the dominant clusters (paper III-E, Eq. 10-12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.clusters import Clusters
from revisit.core.surface import Surface

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Saliency:
    """How the keypoints of a submap spread over its clusters.

    assignment (n,) int32, the cluster of each keypoint, -1 where there is no cluster; counts (M,) int64, s_m;
    weights (M,) float64, alpha_m, positive, of sum 1.
    """

    assignment: NDArray[np.int32]
    counts: NDArray[np.int64]
    weights: NDArray[np.float64]


def weigh_clusters(keypoints: Array, surface: Surface, clusters: Clusters, epsilon: float) -> Saliency:
    """Assign each keypoint (n, 2), metres, to the cluster nearest its column, count, and normalise with `epsilon`.

    The 3D support region of a keypoint is the vertical column over its pixel, so the distance of Eq. 10 is horizontal.
    """
    if clusters.count == 0:
        nothing = np.zeros(0)
        return Saliency(np.full(len(keypoints), -1, np.int32), nothing.astype(np.int64), nothing)
    rows = np.flatnonzero(clusters.labels >= 0)
    tree = cKDTree(surface.vertices.take(rows, axis=0)[:, :2], balanced_tree=False, compact_nodes=False)
    _, nearest = tree.query(keypoints)
    assignment = clusters.labels[rows[nearest]].astype(np.int32)  # Eq. 10
    counts = np.bincount(assignment, minlength=clusters.count)  # Eq. 11
    raised = counts + epsilon
    return Saliency(assignment, counts, raised / raised.sum())  # Eq. 12
