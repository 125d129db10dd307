"""Arrays on their way to a device of torch."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def moved_there(array: NDArray[np.generic], where: torch.device) -> Tensor:
    """The `array` on the device `where`; torch takes no array that is read-only, such as bytes that were read."""
    there = torch.from_numpy(np.require(array, requirements=["C", "W"]))
    return there.to(where, non_blocking=True)  # what is not pinned has been read when this returns
