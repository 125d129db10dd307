"""The chances with which models of stored bits begin, as `lab.training` has learned them."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources

import numpy as np
from numpy.typing import NDArray


def learned_chances(file: str, kind: str = "") -> NDArray[np.int32]:
    """The models (n, 2) of a file in core/weights, those of a `kind` where it holds several: chances, and how sure."""
    stored = learned_arrays(file, (f"{kind}chances", f"{kind}seen"))
    return np.stack(list(stored.values()), axis=1).astype(np.int32)


def learned_arrays(file: str, names: Iterable[str]) -> dict[str, NDArray[np.integer]]:
    """Arrays of a file in core/weights by their names."""
    with (
        resources.files("revisit.core").joinpath("weights", file).open("rb") as opened,
        np.load(opened, allow_pickle=False) as stored,
    ):
        return {name: stored[name] for name in names}
