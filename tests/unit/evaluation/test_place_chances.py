"""Chances learned from places: what has been seen takes fewer bytes."""

from __future__ import annotations

import numpy as np

from revisit.core.kernels.range_coder import fresh_models
from revisit.core.place_surface import MODELS, coded, kinds, rounded
from revisit.evaluation.training.place_chances import SURE, learned_chances
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
