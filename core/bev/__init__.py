"""Cluster-guided BEV image and its oriented patch features (paper III-D, III-E, Eq. 7-9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev.keypoints import (
    context_histograms,
    describe_patches,
    detect_keypoints,
    dominant_orientations,
    reversed_patches,
)
from revisit.core.bev.layout import layout_spectrum
from revisit.core.bev.log_gabor import OrientationMap, maximum_index_map
from revisit.core.bev.projection import cluster_supported, project
from revisit.core.clusters import Clusters
from revisit.core.config import BevConfig
from revisit.core.stages import stage
from revisit.core.surface import Surface

Array = NDArray[np.float32]

__all__ = ["BevFeatures", "describe_bev", "reversed_patches"]


@dataclass(frozen=True)
class BevFeatures:
    """The bird's-eye view of a submap.

    image (H, W) float32 0..1, row = y, column = x; keypoints (n, 2) float32 metres in the submap frame, strongest
    first; orientations (n,) float32 radians in [0, pi); descriptors (n, d) float32 unit vectors (Hellinger mapped);
    layout (s,) float32, the layout spectrum; orientation_map the maximum index map; resolution the pixel edge, metres.
    """

    image: Array
    keypoints: Array
    orientations: Array
    descriptors: Array
    layout: Array
    orientation_map: OrientationMap
    resolution: float


@stage("bev")
def describe_bev(surface: Surface, clusters: Clusters, config: BevConfig) -> BevFeatures:
    """Project the cluster-supported voxels, filter, and describe the keypoints of the image."""
    image = project(surface, cluster_supported(surface, clusters, config), config)
    orientation_map = maximum_index_map(image, config)
    pixels = detect_keypoints(image, orientation_map, config)
    angles = dominant_orientations(context_histograms(orientation_map, pixels, config))
    descriptors = describe_patches(orientation_map, pixels, angles, config)
    keypoints = (pixels + np.float32(0.5) - np.float32(image.shape[0] // 2)) * np.float32(surface.resolution)
    layout = layout_spectrum(image, config)
    return BevFeatures(
        image, keypoints.astype(np.float32), angles, descriptors, layout, orientation_map, surface.resolution
    )
