"""Clouds that no place looks like: the work on them is bounded, and the submap says what was left out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from revisit.core.config import ImplicitMapConfig, PipelineConfig
from revisit.core.errors import DegenerateCloud
from revisit.core.implicit_map.fitting import GATHERED_SHARE, accumulate, gather
from revisit.core.implicit_map.neural_points import nearest_to_middle, oriented
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap

BUDGET = 6_000


def noise_sphere(rng: np.random.Generator) -> np.ndarray:
    """Returns everywhere within 80 m: hardly two in one voxel."""
    return rng.normal(size=(40_000, 3)) * 80.0 / 3.0


def lattice(rng: np.random.Generator) -> np.ndarray:
    """A return every half metre: every voxel has neighbours, and all of them are one cluster."""
    steps = np.arange(-8.0, 8.0, 0.5)
    return np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3) + rng.normal(0, 0.01, 3)


def thin_plates(rng: np.random.Generator) -> np.ndarray:
    """Forty parallel walls half a metre apart."""
    points = rng.uniform(-20, 20, (40_000, 3)) * [1, 1, 0.1]
    return np.column_stack([np.round(points[:, 0]) * 0.5, points[:, 1:]])


def pole_forest(rng: np.random.Generator) -> np.ndarray:
    """A thousand thin poles."""
    feet = rng.uniform(-60, 60, (1_000, 1, 2)) + rng.normal(0, 0.05, (1_000, 40, 2))
    return np.concatenate([feet, rng.uniform(-1, 6, (1_000, 40, 1))], axis=2).reshape(-1, 3)


def submap_of(cloud: np.ndarray) -> Submap:
    return Submap.from_cloud(Scan.validated(cloud.astype(np.float32), np.eye(4), 0))


def described(cloud: np.ndarray, scale: float = 1.0) -> DescribedPlace:
    budget = dataclasses.replace(ImplicitMapConfig(), max_points=BUDGET)
    config = dataclasses.replace(PipelineConfig(), implicit_map=budget, scene_scale=scale)
    return describe(submap_of(cloud), load_packaged_models(), config)


@pytest.mark.parametrize("make", [noise_sphere, lattice, thin_plates, pole_forest])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_hostile_cloud_has_no_more_neural_points_than_the_budget_and_says_so(make, scale):
    try:
        place = described(make(np.random.default_rng(0)), scale)
    except DegenerateCloud:
        return  # refused with a reason, after the same bounded work
    assert len(place.neural_map.points) <= BUDGET
    assert "crowded" in place.flags
    assert len(place.surface.vertices) < 10 * BUDGET


def test_no_more_voxels_are_gathered_than_some_budgets():
    config = dataclasses.replace(ImplicitMapConfig(), max_points=1_000)
    assert len(accumulate(submap_of(noise_sphere(np.random.default_rng(1))), config)) == GATHERED_SHARE * 1_000


def test_the_neural_points_nearest_to_the_middle_stay_in_their_order():
    submap = submap_of(noise_sphere(np.random.default_rng(2))[:2_000])
    every = accumulate(submap, ImplicitMapConfig())
    kept = oriented(gather(submap, ImplicitMapConfig()), ImplicitMapConfig().resolution, 500)
    ranges = np.linalg.norm(every.positions, axis=1)
    inside = ranges <= np.sort(ranges)[499]
    assert np.array_equal(kept.positions, every.positions[inside])
    assert np.array_equal(kept.normals, every.normals[inside])  # of all returns around them
    assert np.array_equal(nearest_to_middle(every.positions, len(every)), np.arange(len(every)))
