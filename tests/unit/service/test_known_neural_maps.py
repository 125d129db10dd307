"""Neural maps that a worker has written or read lately: the same as those that are decoded anew, to a bit."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.codec import known_points
from revisit.core.codec.known_points import KnownPoints
from revisit.core.config import ImplicitMapConfig
from revisit.core.errors import DataLoss
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.settled import settle
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.overlap import compare_pairs
from revisit.core.model_bundle import load_packaged_models
from revisit.service.adapters import core_neural_maps
from revisit.service.adapters.core_neural_maps import decoded, written

CONFIG = ImplicitMapConfig()


def hall(seed: int) -> NeuralMap:
    """A floor with noisy normals."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform((-12, -12, -1.8), (12, 12, -1.4), (3000, 3)).astype(np.float32)
    normals = rng.normal((0, 0, 5), 1.0, (3000, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    points = NeuralPoints.remembered(positions, normals, np.full(3000, 4, np.int32), 3)
    return NeuralMap.of_planes(settle(points, CONFIG.resolution), np.arange(3), CONFIG)


@pytest.mark.parametrize("by_writing", [True, False])
def test_a_known_neural_map_gives_the_same_evidence_as_one_that_is_decoded_anew(monkeypatch, by_writing):
    monkeypatch.setattr(core_neural_maps, "KNOWN", KnownPoints(most_bytes=2**20))
    blobs = [written(hall(1)), written(hall(2))] if by_writing else [hall(1).to_blob(), hall(2).to_blob()]
    fresh = [NeuralMap.from_blob(blob, load_packaged_models().decoder, CONFIG) for blob in blobs]
    if not by_writing:
        assert [len(decoded(blob).points) for blob in blobs] == [len(one.points) for one in fresh]
    monkeypatch.setattr(known_points, "read_points", None)
    known = [decoded(blob) for blob in blobs]
    aside = np.eye(4)
    aside[:3, 3] = (1.0, 0.5, 0.02)
    first, second = (
        compare_pairs([(PlacedMap(one, np.eye(4)), PlacedMap(other, aside))]) for one, other in (fresh, known)
    )
    assert first == second and first.common_points > 1000
    for one, other in zip(fresh, known, strict=True):
        for name, values in vars(one.points).items():
            assert values.tobytes() == getattr(other.points, name).tobytes()


def test_a_damaged_neural_map_is_told_although_the_whole_one_is_known(monkeypatch):
    monkeypatch.setattr(core_neural_maps, "KNOWN", KnownPoints(most_bytes=2**20))
    blob = written(hall(1))
    flipped = blob[:-40] + bytes([blob[-40] ^ 1]) + blob[-39:]
    with pytest.raises(DataLoss):
        decoded(flipped)
    assert len(decoded(blob).points)
