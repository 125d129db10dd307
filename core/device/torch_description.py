"""The kernels of description by torch: on a GPU, or on the processor to compare them (docs/decisions/0219)."""

from __future__ import annotations

import torch

from revisit.core.device.description import DescriptionKernels
from revisit.core.device.torch_maps import TorchMaps
from revisit.core.device.torch_surfaces import TorchSurfaces
from revisit.core.device.torch_views import TorchViews


def torch_description(where: torch.device) -> DescriptionKernels:
    """The kernels of description on the device `where`."""
    return DescriptionKernels(TorchMaps(where), TorchSurfaces(where), TorchViews(where))
