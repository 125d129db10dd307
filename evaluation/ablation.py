"""Ablations: the method without one of its parts (paper Table III)."""

from __future__ import annotations

import dataclasses
from enum import StrEnum

import numpy as np

from revisit.core.config import FusionConfig, PipelineConfig
from revisit.core.model_bundle import ModelBundle
from revisit.core.pipeline import DescribedSurface, describe, describe_surface
from revisit.core.submap import Submap
from revisit.core.surface import surface_from_points


class Ablation(StrEnum):
    """The part left out: none, the implicit map, the cluster part, or the bird's-eye view."""

    NONE = "none"
    NO_IMPLICIT = "no-implicit"
    BEV_ONLY = "bev-only"
    NORMALS_ONLY = "normals-only"


def describe_ablated(
    submap: Submap, models: ModelBundle, config: PipelineConfig, seed: int = 0, ablation: Ablation = Ablation.NONE
) -> DescribedSurface:
    """As `core.pipeline.describe`, without the part that `ablation` names."""
    chosen = dataclasses.replace(config, fusion=_fusion(config.fusion, ablation))
    if ablation is not Ablation.NO_IMPLICIT:
        return describe(submap, models, chosen, seed)
    level, frame = submap.in_level_frame(config.scene_scale)
    surface = surface_from_points(level, config.implicit_map, config.surface)
    return describe_surface(surface, frame, models, chosen, np.random.default_rng(seed))


def _fusion(config: FusionConfig, ablation: Ablation) -> FusionConfig:
    """The weights that leave a part out of the fused descriptor."""
    if ablation is Ablation.BEV_ONLY:
        return dataclasses.replace(config, micro_weight=0.0)
    if ablation is Ablation.NORMALS_ONLY:
        return dataclasses.replace(config, macro_weight=0.0, layout_weight=0.0, plan_weight=0.0)
    return config
