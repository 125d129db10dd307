"""NeuralMap: the implicit map of one submap, a signed distance field on elastic neural points (paper III-B)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.errors import BadTransform, DataLoss, DescriptorModelMismatch
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.implicit_map import blob
from revisit.core.implicit_map.decoder import DecoderWeights, decode
from revisit.core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.settled import geometry, geometry_codes
from revisit.core.kernels.nearest_points import nearest_points
from revisit.core.kernels.neighbour_blend import blend_normals
from revisit.core.kernels.point_columns import PointColumns, columns_of

Array = NDArray[np.float32]

FEATURE_STEP = 0.08
_CHUNK = 65_536


@dataclass(frozen=True)
class NeuralMap:
    """Neural points (n of them), their latent features (n, F) float32 and the decoder they were fitted with.

    Everything in the level frame `frame`, lengths in metres divided by the scene scale. `stamps_ns` (s,) int64 are the
    times of the scans that `points.created` and `points.updated` count. `adapted` says that the decoder was fitted to
    this map too, and so is stored with it.
    """

    points: NeuralPoints
    features: Array
    stamps_ns: NDArray[np.int64]
    decoder: DecoderWeights
    config: ImplicitMapConfig
    frame: LevelFrame = field(default_factory=LevelFrame)
    adapted: bool = False

    def to_blob(self) -> bytes:
        """The compact stored form (docs/decisions/0002): features rounded to multiples of FEATURE_STEP."""
        voxels, octahedral, offsets = geometry_codes(self.points, self.config.resolution)
        order = np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))
        features = np.clip(np.rint(self.features[order] / FEATURE_STEP), -127, 127).astype(np.int8)
        header = {
            "count": len(self.points), "features": int(features.shape[1]), "resolution": self.config.resolution,
            "decoder": self.decoder.digest, "stamps_ns": [int(stamp) for stamp in self.stamps_ns],
            "T_submap_map": self.frame.similarity.ravel().tolist(),
        }  # fmt: skip
        sections = [
            *(blob.to_varint(np.diff(voxels[order, axis], prepend=0)) for axis in range(3)),
            octahedral[order].T.tobytes(),
            offsets[order].tobytes(),
            np.clip(self.points.hits[order], 0, 255).astype(np.uint8).tobytes(),
            features.T.tobytes(),
        ]
        if self.adapted:
            header["layers"] = [list(matrix.shape) for matrix in self.decoder.matrices]
            sections.append(self.decoder.to_bytes())
        return blob.pack(header, sections)

    @classmethod
    def from_blob(cls, data: bytes, decoder: DecoderWeights, config: ImplicitMapConfig) -> NeuralMap:
        """The map in `data`: with the decoder it brings, or else with `decoder`, to which it must have been fitted.

        Raises DataLoss for damage, DescriptorModelMismatch for a map of another decoder.
        """
        header, parts = blob.unpack(data)
        layers = header.get("layers")
        if layers is not None:
            decoder = DecoderWeights.from_bytes(parts[7], layers)
        if header["decoder"] != decoder.digest:
            raise DescriptorModelMismatch("the neural map was fitted with another decoder")
        count, resolution = int(header["count"]), float(header["resolution"])
        voxels = np.stack([np.cumsum(blob.from_varint(parts[axis], count)) for axis in range(3)], axis=1)
        octahedral = np.frombuffer(parts[3], np.uint8).reshape(2, count).T
        codes = (voxels.astype(np.int32), octahedral, np.frombuffer(parts[4], np.uint8))
        positions, normals = geometry(codes, resolution)
        hits = np.frombuffer(parts[5], np.uint8).astype(np.int32)
        stamps = np.asarray(header["stamps_ns"], dtype=np.int64)
        created, updated = np.zeros(count, np.int32), np.full(count, len(stamps) - 1, np.int32)
        points = NeuralPoints(positions, normals, created, updated, hits, hits.astype(np.float32))
        quantised = np.frombuffer(parts[6], np.int8).reshape(int(header["features"]), count).T
        return cls(
            points, np.ascontiguousarray(quantised * np.float32(FEATURE_STEP)), stamps, decoder,
            replace(config, resolution=resolution), _frame(header["T_submap_map"]),
            layers is not None,
        )  # fmt: skip

    @cached_property
    def columns(self) -> PointColumns:
        """The neural points by the column of voxels that they lie in."""
        return columns_of(self.points.positions, self.config.resolution)

    def neighbourhood(self, queries: Array) -> Neighbourhood:
        """The K nearest neural points of `queries` (m, 3) with their weights (paper Eq. 2-4)."""
        cloud = np.ascontiguousarray(queries, dtype=np.float32)
        return find_neighbourhood(cloud, self.points.positions, self.points.normals, self.columns, self.config)

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
            blended = np.einsum("mk,mkf->mf", near.weights, self.features[near.indices])  # Eq. 4
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
        cloud, config = np.ascontiguousarray(queries, dtype=np.float32), self.config
        near = nearest_points(cloud, self.columns, config.resolution, config.neighbours, config.search_rings)
        return np.asarray(blend_normals(*near, self.points.normals, config.weight_power))


def _frame(numbers: ArrayLike) -> LevelFrame:
    try:
        return LevelFrame.from_similarity(np.reshape(np.asarray(numbers, dtype=np.float64), (4, 4)))
    except (BadTransform, TypeError, ValueError) as error:
        raise DataLoss("the level frame of the neural map is no similarity") from error
