"""The narrative: the steps of the method, in order (paper Fig. 2, left to right)."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np

from revisit.core.bev import BevFeatures, describe_bev
from revisit.core.clusters import Clusters, segment_clusters
from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.descriptor.fusion import PlaceDescriptor, PlaceFeatures, fuse
from revisit.core.errors import DegenerateCloud
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.implicit_map import NeuralMap, fit_implicit_map
from revisit.core.micro.cluster_normals import describe_clusters
from revisit.core.micro.saliency import weigh_clusters
from revisit.core.model_bundle import ModelBundle
from revisit.core.place import Place, extract_place
from revisit.core.scan import is_plane
from revisit.core.spectra import describe_spectra
from revisit.core.submap import Submap
from revisit.core.surface import Surface, extract_surface, surface_from_points
from revisit.core.verification import verdict as loop
from revisit.core.verification.verdict import RejectedLoop, VerifiedLoop

Step = TypeVar("Step")


class Ablation(StrEnum):
    """Parts of the method that can be left out (paper Table III)."""

    NONE = "none"
    NO_IMPLICIT = "no-implicit"
    BEV_ONLY = "bev-only"
    NORMALS_ONLY = "normals-only"


@dataclass(frozen=True)
class DescribedPlace:
    """What one submap becomes.

    Surface, clusters, BEV and neural map are in the level frame `frame`: the submap turned upright and divided by the
    scene scale.
    `flags` name what was noticed ("degenerate_plane"); `timings_s` the seconds of each step.
    """

    descriptor: PlaceDescriptor
    place: Place
    neural_map: NeuralMap | None
    surface: Surface
    clusters: Clusters
    bev: BevFeatures
    frame: LevelFrame
    flags: tuple[str, ...]
    timings_s: dict[str, float]


def describe(
    submap: Submap, models: ModelBundle, config: PipelineConfig, seed: int = 0, ablation: Ablation = Ablation.NONE
) -> DescribedPlace:
    """Describe a finished submap: implicit map, surface, clusters, BEV, micro statistics, fused descriptor.

    Raises DegenerateCloud where the descriptor would be zero, which is similar to nothing and fits into no index.
    """
    rng, clock = np.random.default_rng(seed), _StopWatch()
    level = submap.levelled()
    frame = LevelFrame.from_upright(se3.inverse(submap.T_odom_submap) @ level.T_odom_submap, config.scene_scale)
    level = _divided(level, config.scene_scale)
    fusion = _ablated(config, ablation).fusion
    field, surface = _surface(level, models, config, rng, ablation, clock)  # III-B, III-C
    clusters = clock("clusters", lambda: segment_clusters(surface, config.clusters))  # III-C
    bev = clock("bev", lambda: describe_bev(surface, clusters, config.bev))  # III-D, Eq. 7-9
    saliency = weigh_clusters(bev.keypoints, surface, clusters, config.micro.epsilon)  # Eq. 10-12
    micro = clock("micro", lambda: describe_clusters(surface, clusters, bev.keypoints, saliency, config.micro, rng))
    spectra = clock("spectra", lambda: describe_spectra(surface, clusters, config.spectra))
    features = PlaceFeatures(bev, micro, spectra)
    field = field and dataclasses.replace(field, frame=frame)
    descriptor = clock("fusion", lambda: fuse(features, models.codebooks, fusion, models.version))  # Eq. 13-14
    if not descriptor.vector.any():
        raise DegenerateCloud("nothing in the submap's bird's-eye view tells it from other places", field="points")
    place = clock("place", lambda: extract_place(surface, clusters, bev, models.codebooks, config.verification))
    place = dataclasses.replace(place, frame=frame)
    flags = ("degenerate_plane",) if is_plane(submap.points) else ()
    return DescribedPlace(descriptor, place, field, surface, clusters, bev, frame, flags, clock.seconds)


def verify(query: Place, match: Place, similarity: float, config: VerificationConfig) -> VerifiedLoop | RejectedLoop:
    """Whether two places are the same and how they align: SE(2) start, ICP, gates (paper III-E, end).

    `T_match_query` of the answer maps the frame of the query submap into that of the match submap.
    """
    return loop.verify(query, match, similarity, config)


def _divided(submap: Submap, scale: float) -> Submap:
    """The submap with every length divided by `scale`."""
    if scale == 1.0:
        return submap
    factor = np.float32(1.0 / scale)
    return dataclasses.replace(submap, points=submap.points * factor, origins=submap.origins * factor)


def _surface(
    submap: Submap,
    models: ModelBundle,
    config: PipelineConfig,
    rng: np.random.Generator,
    ablation: Ablation,
    clock: _StopWatch,
) -> tuple[NeuralMap | None, Surface]:
    if ablation is Ablation.NO_IMPLICIT:
        return None, clock("surface", lambda: surface_from_points(submap, config.implicit_map, config.surface))
    field = clock("implicit_map", lambda: fit_implicit_map(submap, models.decoder, config.implicit_map, rng))
    return field, clock("surface", lambda: extract_surface(field, config.surface))


def _ablated(config: PipelineConfig, ablation: Ablation) -> PipelineConfig:
    """The configuration whose fused descriptor leaves a part out."""
    if ablation is Ablation.BEV_ONLY:
        return dataclasses.replace(config, fusion=dataclasses.replace(config.fusion, micro_weight=0.0))
    if ablation is Ablation.NORMALS_ONLY:
        fusion = dataclasses.replace(config.fusion, macro_weight=0.0, layout_weight=0.0, plan_weight=0.0)
        return dataclasses.replace(config, fusion=fusion)
    return config


class _StopWatch:
    """Runs steps and notes how long each took."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(self, name: str, step: Callable[[], Step]) -> Step:
        started = time.perf_counter()
        result = step()
        self.seconds[name] = time.perf_counter() - started
        return result
