"""Where the kernels of description run: on the processor, or on a device of torch (docs/decisions/0295).

description      their requests and ports
compiled_description                         by the compiled functions of `core.kernels`
torch_description                            by torch: torch_maps (torch_normals, torch_visibility), torch_surfaces
                                             (torch_neighbours), torch_views; torch_order, torch_replay, torch_arrays
choice           which device is in use
"""

from revisit.core.device.choice import (
    CPU,
    TORCH_ON_CPU,
    Device,
    MissingDevice,
    device,
    open_device,
    require_device,
    use,
    using,
)

__all__ = [
    "CPU",
    "TORCH_ON_CPU",
    "Device",
    "MissingDevice",
    "device",
    "open_device",
    "require_device",
    "use",
    "using",
]
