"""Which device does the kernels: the processor by compiled code, or one that torch knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TypeVar

from revisit.core.device.contract import Kernels
from revisit.core.device.description import DescriptionKernels
from revisit.core.device.together import side_by_side
from revisit.core.errors import BadField

Result = TypeVar("Result")
Item = TypeVar("Item")

CPU = "cpu"
TORCH_ON_CPU = "torch-cpu"

TOGETHER = 32
"""Works that are done side by side on a GPU: each has a thread, and its jobs lie in the memory of the device."""


def _compiled_description() -> DescriptionKernels:
    from revisit.core.device.compiled_description import compiled_description  # and its compiler, as of _processor

    return compiled_description()


class MissingDevice(BadField):
    """The device is not there."""


@dataclass(frozen=True)
class Device:
    """A device by the name it was chosen by, and its kernels of verification and of description.

    It does up to `together` works side by side.
    """

    name: str
    kernels: Kernels
    together: int = 1
    description: DescriptionKernels = field(default_factory=_compiled_description)


_DEVICE: ContextVar[Device | None] = ContextVar("_DEVICE", default=None)


def open_device(name: str) -> Device:
    """The device of a name: `cpu`, `cuda`, `cuda:N`, or `torch-cpu`, which does on the processor what a GPU would do.

    Raises MissingDevice where it is none of these, or not there: nothing else is taken in its place.
    """
    if name == CPU:
        return _processor()
    try:
        from revisit.core.device.torch_description import torch_description
        from revisit.core.device.torch_kernels import open_torch_kernels
    except ImportError as missing:
        hint = f"device {name} needs torch, which is not installed: pip install 'revisit-loops[learned]'"
        raise MissingDevice(hint, field="device") from missing
    try:
        kernels = open_torch_kernels("cpu" if name == TORCH_ON_CPU else name)
        return Device(name, kernels, TOGETHER, torch_description(kernels.where))
    except ValueError as error:
        raise MissingDevice(f"device {name}: {error}", field="device") from error


def require_device(name: str) -> None:
    """Raises MissingDevice where `open_device` does. The processor is always there."""
    if name != CPU:
        open_device(name)


@lru_cache(maxsize=1)
def _processor() -> Device:
    from revisit.core.device.compiled import CompiledKernels  # and its compiler, only where something is computed

    return Device(CPU, CompiledKernels())


def device() -> Device:
    """The device in use here; `cpu` where none was chosen."""
    return _DEVICE.get() or _processor()


def use(chosen: Device) -> None:
    """Use this device from now on, in the context of the caller."""
    _DEVICE.set(chosen)


@contextmanager
def using(chosen: Device) -> Iterator[None]:
    """Use this device inside the block."""
    token = _DEVICE.set(chosen)
    try:
        yield
    finally:
        _DEVICE.reset(token)


def at_once(works: Sequence[Callable[[], Result]]) -> list[Result]:
    """What the works give, in their order: one after another, or side by side on a device that gains by that.

    Raises what the first of them raises that does.
    """
    results: list[Result] = []
    for some in batched(works):
        if len(some) == 1:
            results.append(some[0]())
        else:
            results += side_by_side(some, device().kernels, _seated)
    return results


def batched(items: Sequence[Item]) -> Iterator[Sequence[Item]]:
    """As many items at once as the device in use does side by side: one by one on the processor."""
    chosen = _DEVICE.get()
    step = 1 if chosen is None else chosen.together
    for start in range(0, len(items), step):
        yield items[start : start + step]


def _seated(kernels: Kernels, work: Callable[[], Result]) -> Result:
    """Do a work with the kernels of its seat."""
    with using(replace(device(), kernels=kernels, together=1)):
        return work()
