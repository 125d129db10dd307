"""The chances and weights with which the models of a stored map begin (`lab.training.map_chances`)."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from revisit.core.codec.learned_chances import learned_arrays
from revisit.core.kernels import guided_planes, mixed_octree
from revisit.core.kernels.mixed_coder import Mixture, fresh_mixture

LEARNED = "neural-map-1.npz"
"""Where in core/weights they are."""
CHANCE_STEP = 256
"""Chances are kept in one byte each."""


class Mixtures(NamedTuple):
    """The models of the octree and of the planes of one map."""

    octree: Mixture
    planes: Mixture

    def copied(self) -> Mixtures:
        """The same, to learn on without the first knowing."""
        return Mixtures(*(Mixture(one.models.copy(), one.weights.copy(), one.at.copy()) for one in self))


def fresh_mixtures() -> Mixtures:
    """Models that have seen nothing: for training."""
    return Mixtures(
        fresh_mixture(mixed_octree.OCTREE_MODELS, mixed_octree.OCTREE_SETS),
        fresh_mixture(guided_planes.PLANE_MODELS, guided_planes.PLANE_SETS),
    )


def learned_mixtures() -> Mixtures:
    """Models as they begin in each map."""
    return _learned().copied()


@lru_cache(maxsize=1)
def _learned() -> Mixtures:
    """The models of the file in core/weights: chances, how sure they are, and weights; what none has seen is even."""
    mixtures = fresh_mixtures()
    for kind, mixture in zip(Mixtures._fields, mixtures, strict=True):
        names = f"{kind}_seen", f"{kind}_chances", f"{kind}_weights"
        seen, chances, weights = learned_arrays(LEARNED, names).values()
        mixture.models[:, 1] = seen
        mixture.models[seen > 0, 0] = chances.astype(np.int32) * CHANCE_STEP + CHANCE_STEP // 2
        mixture.weights[:] = weights
    return mixtures
