"""Stored neural maps decoded with the packaged decoder, which a process loads once."""

from __future__ import annotations

from functools import lru_cache

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import DecoderWeights, NeuralMap
from revisit.core.model_bundle import load_packaged_models


def decoded(blob: bytes) -> NeuralMap:
    """A neural map out of its blob. Raises DataLoss, FormerForm, DescriptorModelMismatch."""
    return NeuralMap.from_blob(blob, _decoder(), ImplicitMapConfig())


@lru_cache(maxsize=1)
def _decoder() -> DecoderWeights:
    return load_packaged_models().decoder
