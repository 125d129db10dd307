"""Chances learned from neural maps: what has been seen takes fewer bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lab.training.map_chances import SURE, learned
from revisit.core.codec.neural_chances import fresh_mixtures, learned_mixtures
from revisit.core.codec.neural_points import PlaneCodes, write_points

FILE = Path(__file__).resolve().parents[3] / "core/weights/neural-map-1.npz"


def bumps(seed: int) -> PlaneCodes:
    rng = np.random.default_rng(seed)
    side = np.stack(np.meshgrid(np.arange(-30, 30), np.arange(-30, 30)), axis=-1).reshape(-1, 2)
    kept = side[rng.random(len(side)) < 0.7]
    planes = np.column_stack([15 + rng.integers(-2, 3, (len(kept), 2)), rng.integers(-2, 3, len(kept)), kept[:, 0] % 2])
    return PlaneCodes(np.column_stack([kept, -4 + kept[:, 0] // 16]).astype(np.int32), planes.astype(np.int32))


def size_of(codes: PlaneCodes, mixtures) -> int:
    return len(write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48, 2, mixtures)[1])


def test_a_map_takes_fewer_bytes_with_chances_learned_from_others_like_it() -> None:
    arrays, mixtures = learned(bumps(seed) for seed in range(3)), fresh_mixtures()
    for kind, mixture in zip(mixtures._fields, mixtures, strict=True):
        mixture.models[:, 1] = arrays[f"{kind}_seen"]
        mixture.models[arrays[f"{kind}_seen"] > 0, 0] = arrays[f"{kind}_chances"].astype(np.int32) * 256 + 128
        mixture.weights[:] = arrays[f"{kind}_weights"]
        assert arrays[f"{kind}_seen"].max() == SURE
    assert size_of(bumps(9), mixtures) < 0.95 * size_of(bumps(9), fresh_mixtures())


def test_the_chances_in_the_package_are_of_all_models_and_no_map_changes_them() -> None:
    with np.load(FILE) as stored:
        for kind, mixture in zip(("octree", "planes"), fresh_mixtures(), strict=True):
            assert len(stored[f"{kind}_seen"]) == len(mixture.models)
            assert stored[f"{kind}_weights"].shape == mixture.weights.shape
    before = learned_mixtures()
    assert size_of(bumps(1), None) == size_of(bumps(1), None)
    for one, other in zip(before, learned_mixtures(), strict=True):
        assert np.array_equal(one.models, other.models) and np.array_equal(one.weights, other.weights)
