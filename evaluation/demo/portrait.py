"""One submap of the demo as the method sees it, for the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Portrait:
    """A submap's BEV image (H, W) 0..1 with `pixel_m` metres a pixel and keypoints (k, 2) metres, and its mesh."""

    bev: Array
    pixel_m: float
    keypoints: Array
    vertices: Array
    faces: NDArray[np.int32]


def portray(scans: Sequence[Scan], config: PipelineConfig) -> Portrait:
    """Describe the submap of `scans` with the packaged models. Raises the method's errors for unusable scans."""
    place = describe(Submap.from_window(list(scans), config.submap), load_packaged_models(), config)
    surface = place.surface
    return Portrait(place.bev.image, surface.resolution, place.bev.keypoints, surface.vertices, surface.faces)
