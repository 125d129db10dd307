"""A neural map that an earlier version has stored is read by this one, and answers as it did then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.config import Field, ImplicitMapConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch
from revisit.core.implicit_map import DecoderWeights, NeuralMap

KEPT = Path(__file__).parent / "neural_maps"
SECOND = (KEPT / "second-form.bin").read_bytes()
THIRD = (KEPT / "third-form.bin").read_bytes()
STORED = (KEPT / "first-form.bin").read_bytes()


@pytest.fixture(scope="module")
def decoder() -> DecoderWeights:
    with np.load(KEPT / "first-form-decoder.npz") as archive:
        return DecoderWeights.from_arrays(dict(archive))


def test_a_map_of_version_0_1_answers_as_it_did(decoder):
    known = np.load(KEPT / "first-form-distances.npy")
    distance, _ = NeuralMap.from_blob(STORED, decoder, ImplicitMapConfig()).sdf(known[:, :3])
    assert len(known) == 300 and np.ptp(known[:, 3]) > 0.4
    assert np.abs(distance - known[:, 3]).max() < 1e-4


def test_a_map_of_version_0_1_is_stored_in_the_new_form_from_then_on(decoder):
    field = NeuralMap.from_blob(STORED, decoder, ImplicitMapConfig())
    again = NeuralMap.from_blob(field.to_blob(), decoder, ImplicitMapConfig())
    queries = np.load(KEPT / "first-form-distances.npy")[:, :3]
    assert again.config.field is Field.LEARNED and again.config.weight_power == 1.0
    assert np.median(np.abs(again.sdf(queries)[0] - field.sdf(queries)[0])) < 0.01
    assert np.array_equal(again.stamps_ns, field.stamps_ns)


def test_a_map_of_version_0_1_needs_its_decoder_and_all_of_its_bytes(decoder):
    with pytest.raises(DescriptorModelMismatch):
        NeuralMap.from_blob(STORED, DecoderWeights.tangent_planes(), ImplicitMapConfig())
    for damaged in (STORED[:-1], STORED[:200] + b"?" + STORED[201:], b""):
        with pytest.raises(DataLoss):
            NeuralMap.from_blob(damaged, decoder, ImplicitMapConfig())


@pytest.mark.parametrize(("form", "stored"), [("second", SECOND), ("third", THIRD)])
def test_a_map_of_an_older_form_answers_as_it_did_and_is_stored_again_in_fewer_bytes(form, stored, decoder):
    known = np.load(KEPT / f"{form}-form-distances.npy")
    field = NeuralMap.from_blob(stored, decoder, ImplicitMapConfig())
    distance, _ = field.sdf(known[:, :3])
    assert len(known) == 300 and np.ptp(known[:, 3]) > 0.4
    assert np.abs(distance - known[:, 3]).max() < 1e-4
    again = field.to_blob()
    assert again[:4] == stored[:4] and again[4] == 4
    assert len(again) < 0.9 * len(stored)
    renewed = NeuralMap.from_blob(again, decoder, ImplicitMapConfig())
    assert len(renewed.points) == len(field.points) and np.array_equal(renewed.stamps_ns, field.stamps_ns)
    assert np.median(np.abs(renewed.sdf(known[:, :3])[0] - distance)) < 0.01
