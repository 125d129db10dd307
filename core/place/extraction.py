"""The place of a submap: its keypoints, and an evenly spread part of its surface."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev import BevFeatures
from revisit.core.clusters import Clusters
from revisit.core.codec.place import PlaceContents, settled_form
from revisit.core.codec.place_surface import CORNER
from revisit.core.config import VerificationConfig
from revisit.core.descriptor.vlad import Codebooks, project_locally
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys
from revisit.core.kernels.octree_coder import ranks_of
from revisit.core.place.place import Place
from revisit.core.stages import stage
from revisit.core.surface import Surface

Array = NDArray[np.float32]


@stage("place")
def extract_place(
    surface: Surface,
    clusters: Clusters,
    bev: BevFeatures,
    codebooks: Codebooks,
    config: VerificationConfig,
) -> Place:
    """The place of a submap: its keypoints, and a thinned, evenly spread copy of its surface."""
    standing = _spread_rows(surface.vertices, ~clusters.ground, config.spacing, config.standing_points)
    ground = _spread_rows(surface.vertices, clusters.ground, 2.0 * config.spacing, config.ground_points)
    rows = np.concatenate([standing, ground])
    contents = PlaceContents(
        bev.keypoints, bev.orientations, project_locally(bev.descriptors, codebooks), codebooks.local_parity,
        surface.vertices[rows], surface.normals[rows], len(standing),
    )  # fmt: skip
    stored = settled_form(contents, float(config.spacing))
    return Place(**vars(stored), model=patch_model(codebooks), spacing=float(config.spacing))


def patch_model(codebooks: Codebooks) -> str:
    """A digest of the basis that keypoint descriptors are projected on: only those of one basis are comparable."""
    return hashlib.sha256(np.ascontiguousarray(codebooks.local_basis).tobytes()).hexdigest()[:16]


def _spread_rows(points: Array, chosen: NDArray[np.bool_], spacing: float, limit: int) -> NDArray[np.int64]:
    """One row for each cube of edge `spacing` among the chosen points; where still too many, those of least rank.

    Cubes of the least ranks are spread evenly, and of which rank one is need not be written (docs/decisions/0287).
    """
    x, y, z = np.abs(points).T
    near = np.flatnonzero(chosen & (x < 300.0) & (y < 300.0) & (z < 300.0))
    cubes = np.floor(points.take(near, axis=0).T.astype(np.float64) / spacing + CORNER).astype(np.int64).T
    first = first_rows(voxel_keys(cubes))
    spread = near[first]
    if len(spread) <= limit:
        return np.asarray(spread)
    return np.asarray(spread[np.sort(np.argsort(ranks_of(cubes[first]), kind="stable")[:limit])])
