"""Bits and numbers whose chances several models give together, each weighted by how well it has guessed so far.

A logistic mixture: the models' odds are averaged, with weights that follow the gradient of the coding cost (Mahoney,
"Adaptive Weighing of Context Models for Lossless Data Compression", 2005). Whole numbers throughout.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined
from revisit.core.kernels.range_coder import Coder, Models, fresh_models, learn, narrow

WAYS = 5
"""Models that are asked for each bit."""
SLOTS = 24
"""Models of one context of whole numbers, and sets of weights of one class of them."""

_ODDS = 2047
_UNIT = 256.0  # parts of the logarithm of odds
_EVEN_WEIGHT = (1 << 17) // WAYS  # together above 1: a model that has seen little is too careful
_RATE = 14
_STRETCH = np.clip(
    np.rint(_UNIT * np.log((np.arange(4096) + 0.5) / (4095.5 - np.arange(4096)))), -_ODDS, _ODDS
).astype(np.int16)  # fmt: skip
_SQUASH = np.clip(
    np.rint(65536.0 / (1.0 + np.exp(-np.arange(-_ODDS, _ODDS + 1) / _UNIT))), 32, 65536 - 32
).astype(np.uint16)  # fmt: skip


class Mixture(NamedTuple):
    """models (n, 2); weights (sets, WAYS) int64 in parts of 2^16; `at` (WAYS,) int64, which models are asked next."""

    models: Models
    weights: NDArray[np.int64]
    at: NDArray[np.int64]


def fresh_mixture(models: int, sets: int) -> Mixture:
    """So many models and sets of weights that have seen nothing."""
    weights = np.full((sets, WAYS), _EVEN_WEIGHT, dtype=np.int64)
    return Mixture(fresh_models(models), weights, np.zeros(WAYS, dtype=np.int64))


@inlined
def mixed_bit(coder: Coder, data: NDArray[np.uint8], mixture: Mixture, slot: int, which: int, bit: int) -> int:
    """Write `bit` with the chance that the models `mixture.at` + `slot` give it together, or read and return it.

    They are weighted by set `which` of the weights; models and weights learn of the bit.
    """
    models, weights, at = mixture.models, mixture.weights, mixture.at
    total = 0
    for k in range(WAYS):
        total += weights[which, k] * _STRETCH[models[at[k] + slot, 0] >> 4]
    chance = _SQUASH[min(max(total >> 16, -_ODDS), _ODDS) + _ODDS]
    bit = narrow(coder, data, chance, bit)
    wrong = (65536 if bit else 0) - chance
    for k in range(WAYS):
        weights[which, k] += (_STRETCH[models[at[k] + slot, 0] >> 4] * wrong * _RATE + (1 << 17)) >> 18
        learn(models, at[k] + slot, bit)
    return bit
