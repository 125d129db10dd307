"""The two forms of the method: the product's, and the paper's as it is written (docs/decisions/0122)."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from revisit.core.config import (
    ANGLE_BINS,
    Evaluation,
    Field,
    Fitting,
    KeypointSource,
    Loss,
    PipelineConfig,
    Profile,
)

if TYPE_CHECKING:
    from revisit.core.model_bundle import ModelBundle

__all__ = ["PAPER_FILE", "Profile", "profile_config", "profile_models"]

PAPER_FILE = "paper-1.npz"


def profile_models(profile: Profile) -> ModelBundle:
    """The shipped models of a profile. Descriptors of different profiles are not comparable."""
    from revisit.core.model_bundle import PACKAGED_FILE, load_packaged_models  # which bring the compiler

    return load_packaged_models(PAPER_FILE if profile is Profile.PAPER else PACKAGED_FILE)


def profile_config(profile: Profile, config: PipelineConfig = PipelineConfig()) -> PipelineConfig:
    """`config` with the parameters that make a profile; the product's are the defaults.

    The paper's: a learned field with an updated decoder, trained with L1 as each scan comes (III-B, Eq. 2-5), inverse
    distances as weights (Eq. 3), one histogram a cluster over random pairs (III-C), FAST on the MIM (III-D), saliency
    inside the VLAD (Eq. 13), VLAD vectors of full size, and nothing but F^B and F^G in the descriptor (Eq. 14).
    """
    if profile is Profile.PRODUCT:
        return config
    books = config.fusion
    macro, micro = books.macro_centres * books.local_size, books.micro_centres * ANGLE_BINS
    return dataclasses.replace(
        config,
        profile=Profile.PAPER,
        implicit_map=dataclasses.replace(
            config.implicit_map, field=Field.LEARNED, weight_power=1.0, loss=Loss.L1, fitting=Fitting.SCAN_BY_SCAN,
            update_decoder=True,
        ),
        bev=dataclasses.replace(config.bev, keypoint_source=KeypointSource.MIM),
        micro=dataclasses.replace(config.micro, evaluation=Evaluation.CLUSTER, distance_bins=1),
        fusion=dataclasses.replace(
            books, macro_size=macro, micro_size=micro, spectrum_size=1, layout_size=1, plan_size=1,
            macro_weight=1.0, micro_weight=1.0, histogram_share=1.0, spectrum_weight=0.0, layout_weight=0.0,
            plan_weight=0.0, literal_saliency=True,
        ),
    )  # fmt: skip
