"""Parameters are checked once, when a configuration is made, and again where they meet the models."""

from __future__ import annotations

import dataclasses
import io
import math
from contextlib import suppress

import numpy as np
import pytest

from revisit.core.config import (
    BevConfig,
    Evaluation,
    FusionConfig,
    ImplicitMapConfig,
    KeypointSource,
    LoopConfig,
    Loss,
    MicroConfig,
    Normalisation,
    PipelineConfig,
    Section,
    SpectrumConfig,
    SubmapConfig,
    VerificationConfig,
)
from revisit.core.errors import BadField, DegenerateCloud
from revisit.core.model_bundle import FIRST_TRAINING, TRAINED_WITH, load_bundle, load_packaged_models, training_record
from revisit.core.pipeline import describe

SECTIONS = [field.name for field in dataclasses.fields(PipelineConfig) if field.default is dataclasses.MISSING]
NUMBERS = [
    (section, field.name)
    for section in SECTIONS
    for field in dataclasses.fields(getattr(PipelineConfig(), section))
    if type(field.default) in (int, float)
]
NEED_OTHER_MODELS = {
    *FIRST_TRAINING, "implicit_map.feature_size",
    *(f"fusion.{field.name}" for field in dataclasses.fields(FusionConfig) if field.type == "int"),
}  # fmt: skip
BEFORE_VERIFICATION = [
    (section, name) for section, name in NUMBERS if section not in ("submap", "loop", "verification")
]


def changed(section: str, **values) -> PipelineConfig:
    config = PipelineConfig()
    return dataclasses.replace(config, **{section: dataclasses.replace(getattr(config, section), **values)})


@pytest.fixture(scope="module")
def yard():
    """A small place: a floor and four walls."""
    from revisit.core.scan import Scan
    from revisit.core.submap import Submap

    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-12, 12, (5000, 2)), np.full(5000, -1.7)])
    x, y = rng.uniform(-7, 7, (2, 12000))
    walls = np.column_stack([np.where(x > 0, x, 8.0 * np.sign(y)), np.where(x > 0, 9.0 * np.sign(y), y), (x + y) / 3])
    points = np.vstack([floor, walls]).astype(np.float32)
    return Submap.from_cloud(Scan.validated(points, np.eye(4), 0))


@pytest.mark.parametrize(
    ("section", "name", "value"),
    [
        (ImplicitMapConfig, "loss", "L1"),
        (BevConfig, "normalisation", "Log"),
        (BevConfig, "keypoint_source", "MIM"),
        (MicroConfig, "evaluation", "clusters"),
        (ImplicitMapConfig, "update_decoder", "yes"),
        (ImplicitMapConfig, "update_decoder", 1),
        (ImplicitMapConfig, "steps", 2.5),
        (ImplicitMapConfig, "steps", True),
        (BevConfig, "saturation_quantile", 1.5),
        (VerificationConfig, "contrast_shifts", ()),
        (VerificationConfig, "contrast_shifts", (2.0, -1.0)),
    ],
)
def test_an_unknown_choice_or_a_wrong_kind_of_value_is_refused_by_name(section, name, value):
    with pytest.raises(BadField) as refused:
        section(**{name: value})
    assert refused.value.field == f"{section.section}.{name}"


@pytest.mark.parametrize(
    ("section", "values", "field"),
    [
        (SubmapConfig, {"min_range": 90.0}, "min_range"),
        (ImplicitMapConfig, {"front_reach": 0.2}, "front_reach"),
        (BevConfig, {"patch_px": 4}, "patch_px"),
        (BevConfig, {"layout_harmonics": 31}, "layout_harmonics"),
        (SpectrumConfig, {"highest": 0.5}, "highest"),
        (SpectrumConfig, {"reach": 200.0}, "reach"),
        (SpectrumConfig, {"harmonics": 40}, "harmonics"),
        (SpectrumConfig, {"neighbours": 24}, "neighbours"),
        (VerificationConfig, {"sight_near": 50.0}, "sight_near"),
        (
            FusionConfig,
            {"macro_weight": 0.0, "micro_weight": 0.0, "layout_weight": 0.0, "plan_weight": 0.0},
            "macro_weight",
        ),
    ],
)
def test_values_that_do_not_go_together_are_refused(section, values, field):
    with pytest.raises(BadField) as refused:
        section(**values)
    assert refused.value.field == f"{section.section}.{field}"


def test_every_number_of_every_section_refuses_nan_infinity_and_a_negative_value():
    for section, name in NUMBERS:
        kind: type[Section] = type(getattr(PipelineConfig(), section))
        for value in (math.nan, math.inf, -1, -math.inf):
            with pytest.raises(BadField):
                kind(**{name: value})


def test_a_scale_or_resolution_that_overflows_voxel_indices_is_refused():
    with pytest.raises(BadField):
        PipelineConfig(scene_scale=0.0)
    with pytest.raises(BadField):
        changed("implicit_map", resolution=1e-6)
    with pytest.raises(BadField):
        changed("bev", half_range=1e5)
    assert PipelineConfig(scene_scale=0.01).scene_scale == 0.01


def test_a_choice_may_be_given_by_its_name():
    assert ImplicitMapConfig(loss="l1").loss is Loss.L1  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "config",
    [
        *(changed("implicit_map", loss=loss) for loss in Loss),
        *(changed("bev", normalisation=normalisation) for normalisation in Normalisation),
        *(changed("bev", keypoint_source=source) for source in KeypointSource),
        changed("implicit_map", update_decoder=True),
        changed("fusion", literal_saliency=True),
    ],
    ids=lambda config: None,
)
def test_every_choice_describes_a_place(yard, config):
    vector = describe(yard, load_packaged_models(), config).descriptor.vector
    assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-5)


def test_psi_over_whole_clusters_works_with_models_that_were_trained_so(yard):
    config = changed("micro", evaluation=Evaluation.CLUSTER)
    packaged = load_packaged_models()
    with pytest.raises(BadField, match=r"micro\.evaluation"):
        describe(yard, packaged, config)
    trained = dataclasses.replace(packaged, trained_with={**packaged.trained_with, "micro.evaluation": "cluster"})
    assert np.linalg.norm(describe(yard, trained, config).descriptor.vector) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("section", "values"),
    [
        ("micro", {"evaluation": "cluster", "distance_bins": 1}),
        ("micro", {"height_bins": 2}),
        ("bev", {"orientations": 12}),
        ("bev", {"orientations": 24, "cells": 3}),  # of the same length as 6 and 6
        ("bev", {"layout_radii": 12}),
        ("bev", {"layout_frequency": 0.1}),
        ("spectra", {"frequencies": 12}),
        ("spectra", {"reach": 60.0}),
        ("fusion", {"macro_size": 100}),
        ("implicit_map", {"feature_size": 4}),
    ],
)
def test_a_parameter_that_the_models_were_not_trained_with_is_refused_by_name(yard, section, values):
    with pytest.raises(BadField) as refused:
        describe(yard, load_packaged_models(), changed(section, **values))
    assert refused.value.field in {f"{section}.{name}" for name in values}


def test_a_model_file_remembers_what_it_was_trained_with():
    config = changed("micro", evaluation=Evaluation.CLUSTER)
    packaged, buffer = load_packaged_models(), io.BytesIO()
    arrays = {**packaged.decoder.to_arrays(), **packaged.codebooks.to_arrays()}
    np.savez(buffer, **arrays, **{TRAINED_WITH: training_record(config)})
    load_bundle(buffer.getvalue()).require_fits(config)
    with pytest.raises(BadField):
        load_bundle(buffer.getvalue()).require_fits(PipelineConfig())


@pytest.mark.slow
@pytest.mark.parametrize(("section", "name"), BEFORE_VERIFICATION)
def test_every_parameter_can_be_changed_or_says_why_not(yard, section, name):
    default = getattr(getattr(PipelineConfig(), section), name)
    lengths = []
    for factor in (0.5, 1.25, 2.0):
        with suppress(BadField, DegenerateCloud):
            config = changed(section, **{name: type(default)(default * factor)})
            lengths.append(np.linalg.norm(describe(yard, load_packaged_models(), config).descriptor.vector))
    assert lengths or f"{section}.{name}" in NEED_OTHER_MODELS
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)


def test_the_defaults_fit_the_packaged_models():
    load_packaged_models().require_fits(PipelineConfig())
    assert LoopConfig() == PipelineConfig().loop
