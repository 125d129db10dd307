"""The method, one stage a line (paper Fig. 2, left to right): describe a submap, verify a loop.

Between the two a `core.index` recalls candidates (Eq. 15); after them `acceptance.accept` judges the pairs of a drive
together, `pose_graph.optimise` places its submaps, and `merge` joins maps: each is called by itself, where its data is.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from revisit.core.bev import BevFeatures, describe_bev
from revisit.core.clusters import Clusters, segment_clusters
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.fusion import PlaceDescriptor, PlaceFeatures, fuse
from revisit.core.errors import DegenerateCloud
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.implicit_map import NeuralMap, fit_implicit_map
from revisit.core.kernels.plane_votes import plane_scores
from revisit.core.micro.cluster_normals import describe_clusters
from revisit.core.micro.saliency import weigh_clusters
from revisit.core.model_bundle import ModelBundle
from revisit.core.odometry_bend import odometry_bend
from revisit.core.place import Place
from revisit.core.place.extraction import extract_place
from revisit.core.sanity.ground import place_flags
from revisit.core.scan import is_plane
from revisit.core.scan_disagreement import ScanDisagreement, scan_disagreement
from revisit.core.scan_planes import seen_cubes
from revisit.core.spectra import describe_spectra
from revisit.core.submap import Submap
from revisit.core.surface import Surface, extract_surface
from revisit.core.verification import verify as verify


@dataclass(frozen=True)
class DescribedSurface:
    """The views of a submap's surface; surface, clusters and BEV are in the level frame `frame`."""

    descriptor: PlaceDescriptor
    place: Place
    surface: Surface
    clusters: Clusters
    bev: BevFeatures
    frame: LevelFrame


@dataclass(frozen=True)
class DescribedPlace(DescribedSurface):
    """The description of a submap.

    The neural map is in the level frame too; `flags` name what was noticed ("degenerate_plane", "crowded" where it
    filled more voxels than a neural map may have, "odometry_bends" where `odometry_bend` straightened it, and what
    `place_flags` says).
    """

    neural_map: NeuralMap
    flags: tuple[str, ...]


@dataclass(frozen=True)
class FittedSubmap:
    """A submap after its neural map is fitted: its points can be freed.

    `rng` is the state in which fitting has left the random numbers.
    """

    neural_map: NeuralMap
    flags: tuple[str, ...]
    scan_disagreement: ScanDisagreement | None
    rng: np.random.Generator


def describe(submap: Submap, models: ModelBundle, config: PipelineConfig, seed: int = 0) -> DescribedPlace:
    """Describe a finished submap; the same submap and `seed` give the same bits.

    Raises BadField for a configuration that the models were not trained for, and DegenerateCloud where the descriptor
    would be zero, which is similar to nothing and fits into no index.
    """
    return describe_fitted(fit(submap, models, config, seed), models, config)


def fit(submap: Submap, models: ModelBundle, config: PipelineConfig, seed: int = 0) -> FittedSubmap:
    """The part of `describe` that looks at the points. Raises BadField."""
    models.require_fits(config)
    rng = np.random.default_rng(seed)
    level, frame = submap.in_level_frame(config.scene_scale)
    cubes = seen_cubes(level) if level.scan_count > 1 else None
    bend = odometry_bend(level, cubes)  # decision 0081
    if bend is not None:
        level, cubes = bend.straightened(level), None
    neural_map = fit_implicit_map(level, models.decoder, config.implicit_map, rng)  # III-B, Eq. 1-6
    flags = ("degenerate_plane",) * is_plane(submap.points)
    flags += ("ground_tilted",) * level.leans
    flags += place_flags(level.points, config.scene_scale, plane_scores)
    flags += ("crowded",) * neural_map.crowded + ("odometry_bends",) * (bend is not None)
    return FittedSubmap(dataclasses.replace(neural_map, frame=frame), flags, scan_disagreement(level, cubes), rng)


def describe_fitted(fitted: FittedSubmap, models: ModelBundle, config: PipelineConfig) -> DescribedPlace:
    """The part of `describe` that looks at the neural map alone. Raises DegenerateCloud."""
    neural_map = fitted.neural_map
    surface = extract_surface(neural_map, config.surface)  # III-C
    described = describe_surface(surface, neural_map.frame, models, config, fitted.rng)  # III-C to III-E, Eq. 7-14
    place = dataclasses.replace(described.place, scan_disagreement=fitted.scan_disagreement)
    parts = {**vars(described), "place": place}
    return DescribedPlace(**parts, neural_map=neural_map, flags=fitted.flags)


def describe_again(
    neural_map: NeuralMap, models: ModelBundle, config: PipelineConfig, seed: int = 0
) -> DescribedSurface:
    """The description by other `models`, from the stored neural map instead of the scans.

    Raises as `describe` does.
    """
    models.require_fits(config)
    surface = extract_surface(neural_map, config.surface)
    return describe_surface(surface, neural_map.frame, models, config, np.random.default_rng(seed))


def describe_surface(
    surface: Surface, frame: LevelFrame, models: ModelBundle, config: PipelineConfig, rng: np.random.Generator
) -> DescribedSurface:
    """The part of `describe` after the implicit map: clusters, BEV, cluster statistics, spectra, fused descriptor."""
    clusters = segment_clusters(surface, config.clusters)  # III-C
    bev = describe_bev(surface, clusters, config.bev)  # III-D, Eq. 7-9
    saliency = weigh_clusters(bev.keypoints, surface, clusters, config.micro.epsilon)  # III-E, Eq. 10-12
    micro = describe_clusters(surface, clusters, bev.keypoints, saliency, config.micro, rng)  # III-C
    spectra = describe_spectra(surface, clusters, config.spectra)  # decision 0017
    features = PlaceFeatures(bev, micro, spectra)
    descriptor = fuse(features, models.codebooks, config.fusion, models.version)  # III-E, Eq. 13-14
    if not descriptor.vector.any():
        raise DegenerateCloud("nothing in the submap's bird's-eye view tells it from other places", field="points")
    place = extract_place(surface, clusters, bev, models.codebooks, config.verification)
    return DescribedSurface(descriptor, dataclasses.replace(place, frame=frame), surface, clusters, bev, frame)
