"""The trained parts of the method, shipped and versioned together: SDF decoder and codebooks.

Descriptors and neural maps carry `ModelBundle.version`; those of different versions are never compared.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.descriptor.vlad import Codebooks, folded_size
from revisit.core.errors import BadField, DataLoss
from revisit.core.implicit_map import DecoderWeights

Value = str | int | float

PACKAGED_FILE = "revisit-1.npz"
TRAINED_WITH = "trained_with"


FIRST_TRAINING: Mapping[str, Value] = {
    "bev.orientations": 6, "bev.cells": 6, "bev.layout_radii": 24, "bev.layout_harmonics": 6,
    "bev.layout_frequency": 0.2, "micro.evaluation": "keypoint", "micro.distance_bins": 3, "micro.height_bins": 1,
    "spectra.reach": 65.0, "spectra.frequencies": 24, "spectra.highest": 0.25, "spectra.harmonics": 12,
    "spectra.neighbours": 1,
}  # fmt: skip
"""The parameters that define the entries of a feature, as they were when revisit-1.npz was trained."""


@dataclass(frozen=True)
class ModelBundle:
    """Decoder weights and codebooks; `version` names the file's content, `trained_with` the parameters it is for."""

    decoder: DecoderWeights
    codebooks: Codebooks
    version: str
    trained_with: Mapping[str, Value] = field(default_factory=lambda: FIRST_TRAINING)

    def require_fits(self, config: PipelineConfig) -> None:
        """Raise BadField for the first parameter of `config` that these models were not trained for."""
        books = self.codebooks
        sizes = {
            "implicit_map.feature_size": self.decoder.feature_size,
            "fusion.local_size": len(books.local_basis),
            "fusion.macro_centres": len(books.macro_centres),
            "fusion.micro_centres": len(books.micro_centres),
            "fusion.macro_size": folded_size(books.macro_folds),
            "fusion.micro_size": folded_size(books.micro_folds),
            "fusion.spectrum_size": len(books.spectrum_basis),
            "fusion.layout_size": len(books.layout_basis),
            "fusion.plan_size": len(books.plan_basis),
        }
        for name, trained in {**self.trained_with, **sizes}.items():
            value = parameter_value(config, name)
            if value != trained:
                raise BadField(f"{name} is {value}, but the models were trained with {trained}", field=name)


def parameter_value(config: PipelineConfig, name: str) -> Value:
    """The value of the parameter `section.name`."""
    section, _, parameter = name.partition(".")
    value: Value = getattr(getattr(config, section), parameter)
    return value


def training_record(config: PipelineConfig) -> NDArray[np.uint8]:
    """`trained_with` as an array for a model file, read back by `load_bundle`."""
    record = {name: parameter_value(config, name) for name in FIRST_TRAINING}
    return np.frombuffer(json.dumps(record).encode(), np.uint8)


def load_bundle(data: bytes) -> ModelBundle:
    """The bundle in the bytes of an npz file of plain arrays. Raises DataLoss for damage."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays: dict[str, NDArray[Any]] = {name: archive[name] for name in archive.files}
        record = arrays.pop(TRAINED_WITH, None)
        trained_with = FIRST_TRAINING if record is None else json.loads(record.tobytes())
        decoder, codebooks = DecoderWeights.from_arrays(arrays), Codebooks.from_arrays(arrays)
    except (OSError, ValueError, KeyError) as error:
        raise DataLoss(f"the model file is damaged: {error}") from error
    return ModelBundle(decoder, codebooks, "revisit-" + hashlib.sha256(data).hexdigest()[:12], trained_with)


@lru_cache(maxsize=2)
def load_packaged_models(file: str = PACKAGED_FILE) -> ModelBundle:
    """The bundle that is shipped in core/weights as `file`: the files the core reads, part of its own code."""
    return load_bundle(resources.files("revisit.core").joinpath("weights", file).read_bytes())
