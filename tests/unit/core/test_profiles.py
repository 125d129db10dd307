"""The product's form of the method and the paper's, side by side."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import Evaluation, Field, Fitting, KeypointSource, Loss, PipelineConfig
from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.core.pipeline import describe, verify
from revisit.core.profiles import Profile, profile_config, profile_models
from revisit.core.submap import Submap
from revisit.core.verification import VerifiedLoop
from revisit.evaluation.perturbations import turned
from tests.unit.core.test_pipeline import town


@pytest.fixture
def street(make_drive, shapes) -> Submap:
    return make_drive(lambda _: town(shapes, 3), scans=5)


def test_the_product_is_the_default() -> None:
    assert profile_config(Profile.PRODUCT) == PipelineConfig()


def test_the_paper_is_taken_by_the_letter() -> None:
    config = profile_config(Profile.PAPER)
    assert config.implicit_map.field is Field.LEARNED and config.implicit_map.update_decoder
    assert config.implicit_map.fitting is Fitting.SCAN_BY_SCAN and config.implicit_map.loss is Loss.L1
    assert config.bev.keypoint_source is KeypointSource.MIM
    assert config.micro.evaluation is Evaluation.CLUSTER and config.micro.distance_bins == 1
    assert config.fusion.literal_saliency
    assert (config.fusion.layout_weight, config.fusion.plan_weight, config.fusion.spectrum_weight) == (0.0, 0.0, 0.0)


def test_a_turned_submap_is_found_and_aligned_in_the_form_of_the_paper(street: Submap) -> None:
    config, models = profile_config(Profile.PAPER), profile_models(Profile.PAPER)
    first = describe(street, models, config)
    second = describe(turned(street, 2.0), models, config, seed=1)
    used = first.descriptor.vector != 0.0
    assert used[: config.fusion.macro_size].mean() > 0.1
    assert len(first.descriptor.vector) == config.fusion.macro_size + config.fusion.micro_size + 3
    assert first.descriptor.similarity(second.descriptor) > 0.5
    assert isinstance(verify(second.place, first.place, 1.0, config.verification), VerifiedLoop)


def test_profiles_do_not_mix(street: Submap) -> None:
    product, paper = (describe(street, profile_models(profile), profile_config(profile)) for profile in Profile)
    with pytest.raises(DescriptorModelMismatch):
        product.descriptor.similarity(paper.descriptor)
    with pytest.raises(BadField, match="trained"):
        describe(street, profile_models(Profile.PRODUCT), profile_config(Profile.PAPER))
    assert np.isfinite(paper.descriptor.vector).all()
