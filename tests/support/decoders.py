"""Decoders of an implicit map for tests."""

from __future__ import annotations

import numpy as np

from revisit.core.implicit_map.decoder import ENCODING_SIZE, DecoderWeights


def planes_alone(feature_size: int = 8, width: int = 8) -> DecoderWeights:
    """A decoder that adds nothing to the tangent planes, and is none of the product."""
    size = feature_size + ENCODING_SIZE
    zeros = np.zeros((1, width), dtype=np.float32)
    matrices = np.eye(width, size, dtype=np.float32), zeros
    return DecoderWeights(matrices, (np.zeros(width, dtype=np.float32), np.zeros(1, dtype=np.float32)))
