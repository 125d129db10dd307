"""The chances with which models of stored bits begin, as `evaluation.training.place_chances` has learned them."""

from __future__ import annotations

from importlib import resources

import numpy as np
from numpy.typing import NDArray


def learned_chances(file: str, kind: str = "") -> NDArray[np.int32]:
    """The models (n, 2) of a file in core/weights, those of a `kind` where it holds several: chances, and how sure."""
    with (
        resources.files("revisit.core").joinpath("weights", file).open("rb") as opened,
        np.load(opened, allow_pickle=False) as stored,
    ):
        return np.stack([stored[f"{kind}chances"], stored[f"{kind}seen"]], axis=1).astype(np.int32)
