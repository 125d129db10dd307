"""NeuralMap: the implicit map of one submap, a signed distance field on elastic neural points (paper III-B)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.codec import neural_map as codec
from revisit.core.codec.known_points import KnownPoints
from revisit.core.codec.neural_points import Codes, Form, PlaneCodes, read_points, written_points
from revisit.core.config import Field, ImplicitMapConfig
from revisit.core.errors import BadField, BadTransform, DataLoss, DescriptorModelMismatch
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.implicit_map.decoder import DecoderWeights, decode
from revisit.core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.settled import (
    NORMAL_STEPS,
    OFFSET_UNIT,
    STORED_NORMAL_UNIT,
    geometry,
    hits_of,
    plane_codes,
)
from revisit.core.kernels.nearest_points import nearest_points
from revisit.core.kernels.neighbour_blend import blend_normals
from revisit.core.kernels.plane_distance import plane_distance
from revisit.core.kernels.point_columns import PointColumns, columns_of

Array = NDArray[np.float32]

FEATURE_STEP = 0.08
_CHUNK = 65_536


@dataclass(frozen=True)
class NeuralMap:
    """Neural points (n of them) and the field around them: their tangent planes, or a learned field.

    A learned field has latent features (n, F) float32 and the decoder they were fitted with; else F is 0 and `decoder`
    is None.

    Everything in the level frame `frame`, lengths in metres divided by the scene scale. `stamps_ns` (s,) int64 are the
    times of the scans that `points.created` and `points.updated` count. `adapted` says that the decoder was fitted to
    this map too, and so is stored with it; `crowded`, which is not stored, that the submap filled more voxels than a
    map may have (`max_points`), so that the farthest were left out.
    """

    points: NeuralPoints
    features: Array
    stamps_ns: NDArray[np.int64]
    decoder: DecoderWeights | None
    config: ImplicitMapConfig
    frame: LevelFrame = field(default_factory=LevelFrame)
    adapted: bool = False
    crowded: bool = False

    @classmethod
    def of_planes(
        cls, points: NeuralPoints, stamps_ns: NDArray[np.int64], config: ImplicitMapConfig,
        frame: LevelFrame = LevelFrame(),
    ) -> NeuralMap:  # fmt: skip
        """The map whose field is the blended distance to the points' tangent planes."""
        return cls(points, np.zeros((len(points), 0), np.float32), stamps_ns, None, config, frame)

    def to_blob(self, known: KnownPoints | None = None) -> bytes:
        """The compact stored form (docs/decisions/0287): features rounded to multiples of FEATURE_STEP,
        normals of a map without features to STORED_NORMAL_UNIT steps from their neighbours'. `known` keeps its points
        as they will be read.
        """
        codes = plane_codes(self.points, self.config.resolution)
        features = np.clip(np.rint(self.features / FEATURE_STEP), -127, 127).astype(np.int32)
        unit = STORED_NORMAL_UNIT if self.decoder is None else 1  # features were fitted to the planes as they are
        form, stream, read = written_points(codes, features, NORMAL_STEPS, OFFSET_UNIT, unit)
        if known is not None:
            known.keep(form, stream, read)
        header: dict[str, Any] = {
            "points": form.announced(), "field": [self.config.resolution, self.config.weight_power]
        }  # fmt: skip
        sections = [codec.pack_moments(self.frame.similarity, self.stamps_ns), stream]
        if self.decoder is not None:
            header["decoder"] = self.decoder.digest
        if self.adapted and self.decoder is not None:
            header["layers"] = [list(matrix.shape) for matrix in self.decoder.matrices]
            sections.append(self.decoder.to_bytes())
        return codec.pack(header, sections)

    @classmethod
    def from_blob(
        cls, data: bytes, decoder: DecoderWeights, config: ImplicitMapConfig, known: KnownPoints | None = None
    ) -> NeuralMap:
        """The map in `data`; a learned one with the decoder it brings, or else with `decoder`.

        Its points may be `known`. Raises DataLoss for damage, FormerForm, and DescriptorModelMismatch where a learned
        map has another decoder.
        """
        try:
            return _read(data, decoder, config, read_points if known is None else known.read)
        except (KeyError, IndexError, TypeError, ValueError, BadField) as error:
            raise DataLoss("the stored neural map cannot be read") from error

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
        values, nearest = [np.zeros(0, np.float32)], [np.zeros(0, np.float32)]
        for start in range(0, len(queries), _CHUNK):
            value, gap = self._distances(queries[start : start + _CHUNK])
            value = np.clip(value, -self.config.truncation, self.config.truncation)
            value[~np.isfinite(gap)] = self.config.truncation
            values.append(value)
            nearest.append(gap)
        return np.concatenate(values), np.concatenate(nearest)

    def _distances(self, queries: Array) -> tuple[Array, Array]:
        if self.decoder is None:
            return self._plane_distance(queries)
        near = self.neighbourhood(queries)
        return self._decode(self.decoder, near), near.nearest

    def _decode(self, decoder: DecoderWeights, near: Neighbourhood) -> Array:
        """Signed distances of queries with the neighbourhood `near` by a learned field."""
        blended = np.einsum("mk,mkf->mf", near.weights, self.features[near.indices])  # Eq. 4
        return decode(decoder, blended, near.encoding, near.plane_distance)

    def _plane_distance(self, queries: Array) -> tuple[Array, Array]:
        """Blended distances (m,) to the tangent planes, and distances (m,) to the nearest neural point."""
        cloud, points = np.ascontiguousarray(queries, dtype=np.float32), self.points
        indices, squared = self._nearest(cloud)
        power = self.config.weight_power
        distance = plane_distance(cloud, points.positions, points.normals, indices, squared, power)
        return distance, np.sqrt(squared[:, 0])

    def _nearest(self, cloud: Array) -> tuple[NDArray[np.int32], Array]:
        """Rows (m, k) of the neural points nearest to `cloud` (m, 3), and their squared distances (m, k)."""
        rules = self.config
        return nearest_points(cloud, self.columns, rules.resolution, rules.neighbours, rules.search_rings)

    def normals(self, queries: Array) -> Array:
        """Unit normals (m, 3) towards free space at `queries` (m, 3) near the surface.

        The blend of the neural points' normals: the gradient of the tangent-plane part of the field, without the small
        correction of the decoder. Zero where no neural point is near.
        """
        cloud = np.ascontiguousarray(queries, dtype=np.float32)
        return np.asarray(blend_normals(*self._nearest(cloud), self.points.normals, self.config.weight_power))


_PointReader = Callable[[Form, bytes], tuple[PlaneCodes, Codes]]


def _read(data: bytes, decoder: DecoderWeights, config: ImplicitMapConfig, read: _PointReader) -> NeuralMap:
    header, (seen, stream, *rest) = codec.unpack(data)
    similarity, differences = codec.unpack_moments(seen)
    form = Form.of_header(header)
    codes, features = read(form, stream)
    resolution, power = map(float, header["field"])
    kind = Field.PLANES if header.get("decoder") is None else Field.LEARNED
    config = replace(config, resolution=resolution, weight_power=power, field=kind)
    stamps = np.cumsum(np.frombuffer(differences, "<i8"))
    planes = geometry(codes, resolution, form.normal_steps, form.offset_unit)
    points = NeuralPoints.remembered(*planes, hits_of(codes), len(stamps))
    frame = _frame(np.frombuffer(similarity, "<f8"))
    if kind is Field.PLANES:
        return NeuralMap.of_planes(points, stamps, config, frame)
    own, adapted = _decoder_of(header, rest, decoder)
    return NeuralMap(points, features * np.float32(FEATURE_STEP), stamps, own, config, frame, adapted)


def _decoder_of(header: dict[str, Any], rest: list[bytes], shared: DecoderWeights) -> tuple[DecoderWeights, bool]:
    """The decoder of a learned map: its own, in the `rest` of its sections, or the shared one."""
    layers = header.get("layers")
    decoder = shared if layers is None else DecoderWeights.from_bytes(rest[0], layers)
    if header["decoder"] != decoder.digest:
        raise DescriptorModelMismatch("the neural map was fitted with another decoder")
    return decoder, layers is not None


def _frame(numbers: ArrayLike) -> LevelFrame:
    try:
        return LevelFrame.from_similarity(np.reshape(np.asarray(numbers, dtype=np.float64), (4, 4)))
    except (BadTransform, TypeError, ValueError) as error:
        raise DataLoss("the level frame of the neural map is no similarity") from error
