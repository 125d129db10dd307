"""One neural map out of several that are placed to each other.

All of them are of one kind, tangent planes or learned, so that a neural point means the same in each. Points are moved
and turned into the frame of the map, and where two of them describe one spot the better supported stays. Latent
features, where there are any, are fitted once more, to the fields that they came from; where these have decoders of
their own, for one of these decoders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.config import ImplicitMapConfig
from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.implicit_map import DecoderWeights, NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.settled import settle

Array = NDArray[np.float32]

SAME_SPOT = 0.75
"""Two points closer than this share of the resolution describe one spot, where their normals agree."""

SAME_SIDE = 0.5
"""Cosine between two normals above which they agree: the two sides of a thin wall do not."""

SAMPLES_EACH = 8
SAMPLE_REACH = 0.4
"""Samples of a source's field a point, up to so many metres to both sides of its tangent plane."""


@dataclass(frozen=True)
class PlacedMap:
    """The neural map of a submap, and where the submap lies in the frame of the merged map.

    `session` and `stamp_ns` say which drive saw it, and when; maps without them are of one drive.
    """

    neural_map: NeuralMap
    T_map_submap: se3.Matrix4
    session: int = 0
    stamp_ns: int = 0

    def only(self, kept: NDArray[np.bool_]) -> PlacedMap:
        """With those of its points alone that are `kept` (n,)."""
        rows, whole = np.flatnonzero(kept), self.neural_map
        return replace(self, neural_map=replace(whole, points=whole.points.subset(rows), features=whole.features[rows]))


def merge_neural_maps(placed: Sequence[PlacedMap], seed: int = 0) -> NeuralMap:
    """The neural map of all of them in the frame of `T_map_submap`, lengths divided by their scene scale.

    The order of the maps does not matter where their points have different support. Raises BadField without maps and
    for maps of different resolution or scale, DescriptorModelMismatch where some are tangent planes and others
    learned, MissingLibrary where learned ones are merged without torch.
    """
    config, decoder, scale = _shared(placed)
    moved = [_moved(one, scale) for one in placed]
    owner = np.repeat(np.arange(len(moved)), [len(points) for points in moved])
    every = _joined(moved, [len(one.neural_map.stamps_ns) for one in placed])
    kept = _best_supported(every, owner, config.resolution)
    points, owner = settle(every.subset(kept), config.resolution), owner[kept]
    stamps_ns, frame = np.concatenate([one.neural_map.stamps_ns for one in placed]), LevelFrame(scale=scale)
    if decoder is None:
        return NeuralMap.of_planes(points, stamps_ns, config, frame)
    features = np.zeros((len(points), decoder.feature_size), np.float32)
    adapted = any(one.neural_map.adapted for one in placed)
    merged = NeuralMap(points, features, stamps_ns, decoder, config, frame, adapted)
    return _fitted(merged, owner, placed, decoder, seed)


def _fitted(
    merged: NeuralMap, owner: NDArray[np.int64], placed: Sequence[PlacedMap], decoder: DecoderWeights, seed: int
) -> NeuralMap:
    """The merged map of a learned field with features for the fields of its sources."""
    from revisit.core.implicit_map.gradient_steps import fit_features  # torch, and only where it is needed

    rng, scale, config = np.random.default_rng(seed), merged.frame.scale, merged.config
    positions, labels = _samples_of_sources(merged, owner, placed, scale, rng)
    near = merged.neighbourhood(positions)
    features, _ = fit_features(near, labels, merged.features, decoder, replace(config, update_decoder=False), rng)
    return replace(merged, features=features)


def _shared(placed: Sequence[PlacedMap]) -> tuple[ImplicitMapConfig, DecoderWeights | None, float]:
    """The common parameters and scene scale of the maps; a decoder of theirs, whatever their order."""
    if not placed:
        raise BadField("there is no map to merge", field="maps")
    first = placed[0].neural_map
    for one in (other.neural_map for other in placed):
        if (one.decoder is None) is not (first.decoder is None):
            raise DescriptorModelMismatch("a learned neural map cannot be merged with one of tangent planes")
        if one.config.resolution != first.config.resolution:
            raise BadField("neural maps of different resolution cannot be merged", field="resolution")
        if not np.isclose(one.frame.scale, first.frame.scale):
            raise BadField("neural maps of different scene scale cannot be merged", field="scene_scale")
    decoder = min((one.neural_map for one in placed), key=_digest).decoder
    return first.config, decoder, first.frame.scale


def _digest(neural_map: NeuralMap) -> str:
    """That of the decoder; "" for tangent planes."""
    return "" if neural_map.decoder is None else neural_map.decoder.digest


def _moved(one: PlacedMap, scale: float) -> NeuralPoints:
    """The points of a map in the merged one: positions and normals turned, lengths divided by the scale."""
    T_map_level = _T_map_level(one, scale)
    points = one.neural_map.points
    positions = points.positions @ T_map_level[:3, :3].T + T_map_level[:3, 3]
    normals = points.normals @ T_map_level[:3, :3].T
    return replace(points, positions=positions.astype(np.float32), normals=normals.astype(np.float32))


def _T_map_level(one: PlacedMap, scale: float) -> se3.Matrix4:
    """The rigid motion (4, 4) from the level frame of a map into the merged one, lengths divided by the scale."""
    T_map_upright = one.T_map_submap @ one.neural_map.frame.T_submap_upright
    return se3.from_rotation_translation(T_map_upright[:3, :3], T_map_upright[:3, 3] / scale)


def _joined(moved: Sequence[NeuralPoints], scans: Sequence[int]) -> NeuralPoints:
    """All points in one list; scans are counted on from map to map."""
    before = np.concatenate([[0], np.cumsum(scans)[:-1]]).astype(np.int32)
    return NeuralPoints(
        np.concatenate([one.positions for one in moved]),
        np.concatenate([one.normals for one in moved]),
        np.concatenate([one.created + first for one, first in zip(moved, before, strict=True)]),
        np.concatenate([one.updated + first for one, first in zip(moved, before, strict=True)]),
        np.concatenate([one.hits for one in moved]),
        np.concatenate([one.stability for one in moved]),
    )


def _best_supported(points: NeuralPoints, owner: NDArray[np.int64], resolution: float) -> NDArray[np.bool_]:
    """Which points (n,) stay: one a voxel, and of two maps' points on one spot only that of more hits."""
    order = np.lexsort((np.arange(len(points)), owner, -points.hits))
    rank = np.empty(len(points), dtype=np.int64)
    rank[order] = np.arange(len(points))
    voxels = np.floor(points.positions[order] / resolution).astype(np.int64)
    keys = (voxels[:, 0] << 42) ^ ((voxels[:, 1] & 0x1FFFFF) << 21) ^ (voxels[:, 2] & 0x1FFFFF)
    kept = np.zeros(len(points), dtype=bool)
    kept[order[np.unique(keys, return_index=True)[1]]] = True
    rows = np.flatnonzero(kept)
    pairs = rows[cKDTree(points.positions[rows]).query_pairs(SAME_SPOT * resolution, output_type="ndarray")]
    alike = np.einsum("ni,ni->n", points.normals[pairs[:, 0]], points.normals[pairs[:, 1]]) > SAME_SIDE
    pairs = pairs[alike & (owner[pairs[:, 0]] != owner[pairs[:, 1]])]
    worse = np.where(rank[pairs[:, 0]] > rank[pairs[:, 1]], pairs[:, 0], pairs[:, 1])
    kept[worse] = False
    return kept


def _samples_of_sources(
    merged: NeuralMap, owner: NDArray[np.int64], placed: Sequence[PlacedMap], scale: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Positions (m, 3) around the points of the merged map and the signed distance (m,) that their own map says."""
    positions, labels = [], []
    for number, one in enumerate(placed):
        mine = merged.points.subset(owner == number)
        offsets = rng.uniform(-SAMPLE_REACH, SAMPLE_REACH, (len(mine), SAMPLES_EACH, 1)).astype(np.float32)
        aside = rng.uniform(-0.5, 0.5, (len(mine), SAMPLES_EACH, 3)).astype(np.float32) * merged.config.resolution
        here = (mine.positions[:, None] + offsets * mine.normals[:, None] + aside).reshape(-1, 3)
        T_level_map = se3.inverse(_T_map_level(one, scale))
        values, nearest = one.neural_map.sdf((here @ T_level_map[:3, :3].T + T_level_map[:3, 3]).astype(np.float32))
        known = nearest < merged.config.resolution
        positions.append(here[known])
        labels.append(values[known])
    return np.concatenate(positions), np.concatenate(labels)
