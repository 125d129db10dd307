"""Chances learned from places: what has been seen takes fewer bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lab.training.place_chances import SURE, keep, learned_chances, learned_keypoint_chances
from revisit.core.codec.place import coded_form
from revisit.core.codec.place_keypoints import coded_keypoints
from revisit.core.codec.place_surface import MODELS, coded, kinds, rounded
from revisit.core.kernels.keypoint_models import KEYPOINT_MODELS
from revisit.core.kernels.range_coder import fresh_models
from tests.support.yards import recognised, yard


def test_a_surface_takes_fewer_bytes_with_chances_learned_from_one_like_it() -> None:
    _, place = recognised(yard(1))
    edge, steps = kinds(place.spacing)["standing"]
    standing = rounded(place.points[: place.standing_count], place.normals[: place.standing_count], edge, steps)
    learned = learned_chances([place], place.spacing)
    assert set(learned) == {"standing_chances", "standing_seen", "ground_chances", "ground_seen"}
    assert learned["standing_seen"].max() == SURE
    models = np.stack([learned["standing_chances"], learned["standing_seen"]], axis=1).astype(np.int64)
    assert len(coded(*standing, steps, models)) < 0.9 * len(coded(*standing, steps, fresh_models(MODELS)))


def test_keypoints_take_fewer_bytes_with_chances_learned_from_others_like_them() -> None:
    _, place = recognised(yard(1))
    keypoints = coded_form(place.keypoints, place.orientations, place.descriptors)
    learned = learned_keypoint_chances([place])
    assert learned["chances"].shape == learned["seen"].shape == (KEYPOINT_MODELS,)
    assert learned["seen"].max() == SURE
    models = np.stack([learned["chances"], learned["seen"]], axis=1).astype(np.int32)
    learning = len(coded_keypoints(*keypoints, fresh_models(KEYPOINT_MODELS)))
    assert len(coded_keypoints(*keypoints, models)) < 0.8 * learning


def test_chances_that_are_there_stay(tmp_path: Path) -> None:
    file = tmp_path / "chances.npz"
    keep(file, {"seen": np.arange(3, dtype=np.uint8)})
    written = file.read_bytes()
    keep(file, {"seen": np.arange(4, dtype=np.uint8)})
    assert file.read_bytes() == written
    np.testing.assert_array_equal(np.load(file)["seen"], np.arange(3))
