"""A neural map that an earlier version of the same form has stored is read by this one, and answers as it did then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.config import ImplicitMapConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch, FormerForm
from revisit.core.implicit_map import DecoderWeights, NeuralMap
from tests.support.decoders import planes_alone

KEPT = Path(__file__).parent / "neural_maps"
LEARNED = (KEPT / "learned.bin").read_bytes()


@pytest.fixture(scope="module")
def decoder() -> DecoderWeights:
    with np.load(KEPT / "decoder.npz") as archive:
        return DecoderWeights.from_arrays(dict(archive))


@pytest.mark.parametrize("kind", ["learned", "planes"])
def test_a_stored_map_answers_as_it_did(kind, decoder):
    known = np.load(KEPT / f"{kind}-distances.npy")
    field = NeuralMap.from_blob((KEPT / f"{kind}.bin").read_bytes(), decoder, ImplicitMapConfig())
    distance, _ = field.sdf(known[:, :3])
    assert field.config.field.value == kind
    assert len(known) == 300 and np.ptp(known[:, 3]) > 0.4
    assert np.abs(distance - known[:, 3]).max() < 1e-4


@pytest.mark.parametrize("kind", ["learned", "planes"])
def test_a_stored_map_that_is_stored_again_answers_much_the_same(kind, decoder):
    known, stored = np.load(KEPT / f"{kind}-distances.npy"), (KEPT / f"{kind}.bin").read_bytes()
    field = NeuralMap.from_blob(stored, decoder, ImplicitMapConfig())
    again = NeuralMap.from_blob(field.to_blob(), decoder, ImplicitMapConfig())
    assert again.config == field.config and len(again.points) == len(field.points)
    assert np.median(np.abs(again.sdf(known[:, :3])[0] - known[:, 3])) < 0.01
    assert np.array_equal(again.stamps_ns, field.stamps_ns)


def test_a_learned_map_needs_its_decoder_and_all_of_its_bytes(decoder):
    with pytest.raises(DescriptorModelMismatch):
        NeuralMap.from_blob(LEARNED, planes_alone(), ImplicitMapConfig())
    for damaged in (LEARNED[:-1], LEARNED[:200] + b"?" + LEARNED[201:], b""):
        with pytest.raises(DataLoss):
            NeuralMap.from_blob(damaged, decoder, ImplicitMapConfig())


@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_map_of_a_former_form_is_refused_with_the_command_that_mends_it(version, decoder):
    with pytest.raises(FormerForm, match=r"stored neural map.*revisit reembed MAP"):
        NeuralMap.from_blob(b"RVNM" + bytes([version]) + LEARNED[5:], decoder, ImplicitMapConfig())
