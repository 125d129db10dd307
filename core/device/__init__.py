"""Where kernels run: on the processor, or on a device of torch (docs/decisions/0208, 0219).

contract         what the kernels of verification are asked for, and the port `Kernels`
compiled         by the compiled functions of `core.kernels`
torch_kernels, torch_patches, torch_plans    by torch, many jobs at once
together         works side by side, whose calls are joined
description      what the kernels of description are asked for, and their ports
compiled_description                         by the compiled functions of `core.kernels`
torch_description                            by torch: torch_maps (torch_normals, torch_visibility), torch_surfaces
                                             (torch_neighbours), torch_views; torch_order, torch_arrays
choice           which device is in use
"""

from revisit.core.device.choice import (
    CPU,
    TORCH_ON_CPU,
    Device,
    MissingDevice,
    at_once,
    batched,
    device,
    open_device,
    require_device,
    use,
    using,
)
from revisit.core.device.contract import Kernels

__all__ = [
    "CPU",
    "TORCH_ON_CPU",
    "Device",
    "Kernels",
    "MissingDevice",
    "at_once",
    "batched",
    "device",
    "open_device",
    "require_device",
    "use",
    "using",
]
