"""The kernels of description by torch: on a GPU, or on the processor to compare them."""

from __future__ import annotations

import torch

from lab.gpu.kernels import DescriptionKernels
from lab.gpu.maps import TorchMaps
from lab.gpu.surfaces import TorchSurfaces
from lab.gpu.views import TorchViews


def torch_description(where: torch.device) -> DescriptionKernels:
    """The kernels of description on the device `where`."""
    return DescriptionKernels(TorchMaps(where), TorchSurfaces(where), TorchViews(where))


def find_torch_device(name: str) -> torch.device:
    """The torch device `name`: "cpu", "cuda" or "cuda:N". Raises ValueError where there is none.

    Nothing is reserved on it yet.
    """
    try:
        where = torch.device(name)
    except RuntimeError as error:
        raise ValueError("no name of a device; cpu, cuda, cuda:N or torch-cpu") from error
    if where.type not in ("cpu", "cuda"):
        raise ValueError("kernels run on cpu, cuda, cuda:N or torch-cpu")  # others lack numbers of 64 bits
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if where.type == "cuda" and (where.index or 0) >= there:
        raise ValueError(f"torch {torch.__version__} finds {there} such devices on this machine")
    return where
