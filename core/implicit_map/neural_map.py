"""NeuralMap: the implicit map of one submap, a signed distance field on elastic neural points (paper III-B)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from core.config import ImplicitMapConfig
from core.implicit_map import voxel_hash
from core.implicit_map.decoder import DecoderWeights, decode
from core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from core.implicit_map.neural_points import NeuralPoints

Array = NDArray[np.float32]

_CHUNK = 65_536


@dataclass(frozen=True)
class NeuralMap:
    """Neural points (n of them), their latent features (n, F) float32 and the decoder they were fitted with.

    Everything in the submap frame, metres. `stamps_ns` (s,) int64 are the times of the scans that `points.created` and
    `points.updated` count.
    """

    points: NeuralPoints
    features: Array
    stamps_ns: NDArray[np.int64]
    decoder: DecoderWeights
    config: ImplicitMapConfig

    @cached_property
    def slots(self) -> NDArray[np.int32]:
        """The voxel hash of the neural points."""
        return np.asarray(voxel_hash.build_table(self.points.positions, self.config.resolution))

    def neighbourhood(self, queries: Array) -> Neighbourhood:
        """The K nearest neural points of `queries` (m, 3) with their weights (paper Eq. 2-4)."""
        cloud = np.ascontiguousarray(queries, dtype=np.float32)
        return find_neighbourhood(cloud, self.points.positions, self.points.normals, self.slots, self.config)

    def sdf(self, queries: Array) -> tuple[Array, Array]:
        """Signed distances (m,) metres of `queries` (m, 3), positive in free space, cut at the truncation (Eq. 5).

        The second array (m,) is the distance to the nearest neural point, inf where none is near: there the field
        says nothing and the signed distance is the truncation.
        """
        values, nearest = [], []
        for start in range(0, len(queries), _CHUNK):
            near = self.neighbourhood(queries[start : start + _CHUNK])
            values.append(self._decode(near))
            nearest.append(near.nearest)
        if not values:
            return np.zeros(0, np.float32), np.zeros(0, np.float32)
        return np.concatenate(values), np.concatenate(nearest)

    def _decode(self, near: Neighbourhood) -> Array:
        with torch.no_grad():
            blended = np.einsum("mk,mkf->mf", near.weights, self.features[near.indices])
            value = decode(
                self.decoder.tensors(),
                torch.from_numpy(blended),
                torch.from_numpy(near.encoding),
                torch.from_numpy(near.plane_distance),
            ).numpy()
        value = np.clip(value, -self.config.truncation, self.config.truncation)
        value[~np.isfinite(near.nearest)] = self.config.truncation
        return np.asarray(value, dtype=np.float32)

    def normals(self, queries: Array) -> Array:
        """Unit normals (m, 3) towards free space at `queries` (m, 3) near the surface.

        The blend of the neural points' normals: the gradient of the tangent-plane part of the field, without the small
        correction of the decoder. Zero where no neural point is near.
        """
        near = self.neighbourhood(queries)
        blended = np.einsum("mk,mka->ma", near.weights, self.points.normals[near.indices])
        length = np.linalg.norm(blended, axis=1, keepdims=True)
        return np.asarray(blended / np.maximum(length, 1e-9), dtype=np.float32)
