"""The trained parts of the method, shipped and versioned together: SDF decoder and codebooks.

Descriptors and neural maps carry `ModelBundle.version`; those of different versions are never compared.
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from revisit.core.descriptor.vlad import Codebooks
from revisit.core.errors import DataLoss
from revisit.core.implicit_map import DecoderWeights

PACKAGED_FILE = "revisit-1.npz"


@dataclass(frozen=True)
class ModelBundle:
    """Decoder weights and codebooks; `version` names the file's content."""

    decoder: DecoderWeights
    codebooks: Codebooks
    version: str


def load_bundle(data: bytes) -> ModelBundle:
    """The bundle in the bytes of an npz file of plain arrays. Raises DataLoss for damage."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays: dict[str, NDArray[np.float32]] = {name: archive[name] for name in archive.files}
        decoder, codebooks = DecoderWeights.from_arrays(arrays), Codebooks.from_arrays(arrays)
    except (OSError, ValueError, KeyError) as error:
        raise DataLoss(f"the model file is damaged: {error}") from error
    return ModelBundle(decoder, codebooks, "revisit-" + hashlib.sha256(data).hexdigest()[:12])


@lru_cache(maxsize=1)
def load_packaged_models() -> ModelBundle:
    """The bundle that is shipped in core/weights: the one file the core reads, part of its own code."""
    return load_bundle(resources.files("revisit.core").joinpath("weights", PACKAGED_FILE).read_bytes())
