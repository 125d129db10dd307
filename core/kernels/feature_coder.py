"""Small whole numbers of each neural point, its latent features, as a stream of bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop
from revisit.core.kernels.range_coder import UNARY, Coder, Models, code_number

_SIZES = 4


def feature_models(features: int) -> int:
    """How many models the features of a point need."""
    return max(1, features) * _SIZES * UNARY


@loop
def code_features(coder: Coder, data: NDArray[np.uint8], models: Models, values: NDArray[np.int32]) -> None:
    """Write `values` (n, F), or read and fill them; each is guessed to be about as large as the one before it."""
    count, features = values.shape
    for row in range(count):
        size = 0
        for column in range(features):
            model = (column * _SIZES + min(size, _SIZES - 1)) * UNARY
            values[row, column] = code_number(coder, data, models, model, values[row, column])
            size = abs(values[row, column])
