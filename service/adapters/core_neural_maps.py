"""Stored neural maps decoded with the packaged decoder, which a process loads once; the last ones are known."""

from __future__ import annotations

from functools import lru_cache

from revisit.core.codec.known_points import KnownPoints
from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import DecoderWeights, NeuralMap
from revisit.core.model_bundle import load_packaged_models

KNOWN = KnownPoints(most_bytes=4 * 2**20)
"""The points of some 60 submaps: audits of joins read those of a young map again every few seconds."""


def decoded(blob: bytes) -> NeuralMap:
    """A neural map out of its blob. Raises DataLoss, FormerForm, DescriptorModelMismatch."""
    return NeuralMap.from_blob(blob, _decoder(), ImplicitMapConfig(), KNOWN)


def written(neural_map: NeuralMap) -> bytes:
    """The blob of a neural map, which may be read again soon."""
    return neural_map.to_blob(KNOWN)


@lru_cache(maxsize=1)
def _decoder() -> DecoderWeights:
    return load_packaged_models().decoder
