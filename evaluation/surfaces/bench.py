"""Surface errors and bytes of stored neural maps."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import NeuralMap, fit_implicit_map
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.surfaces.metrics import SurfaceError, mean_error, surface_error
from revisit.evaluation.surfaces.scenes import Scene
from revisit.evaluation.surfaces.zero_level import zero_level

STEP_M = 0.2
"""About the edge of the cells in which the zero level is sought."""


@dataclass(frozen=True)
class Row:
    """One kind of field on one group of scenes: mean errors; kilobytes of a map and its share of the raw cloud; seconds
    of CPU for fitting one submap.
    """

    scenes: str
    kind: str
    error: SurfaceError
    kilobytes: float
    share: float
    fit_s: float


def measure(name: str, kind: str, scenes: Iterable[Scene], config: ImplicitMapConfig) -> Row:
    """Fit, store, read back, and compare the zero level with the truth."""
    decoder, errors, sizes, seconds = load_packaged_models().decoder, [], [], []
    for scene in scenes:
        started = time.process_time()
        fitted = fit_implicit_map(scene.submap, decoder, config, np.random.default_rng(0))
        seconds.append(time.process_time() - started)
        blob = fitted.to_blob()
        stored = NeuralMap.from_blob(blob, decoder, config)
        errors.append(surface_error(zero_level(stored, STEP_M), scene.truth, unit_m=scene.unit_m))
        sizes.append((len(blob) / 1e3, len(blob) / scene.raw_bytes))
    kilobytes, share = np.mean(sizes, axis=0)
    return Row(name, kind, mean_error(errors), float(kilobytes), float(share), float(np.median(seconds)))
