"""Which device does the kernels of description: the processor by compiled code, or one that torch knows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache

from revisit.core.device.description import DescriptionKernels
from revisit.core.errors import BadField

CPU = "cpu"
TORCH_ON_CPU = "torch-cpu"


class MissingDevice(BadField):
    """The device is not there."""


@dataclass(frozen=True)
class Device:
    """A device by the name it was chosen by, and its kernels of description."""

    name: str
    description: DescriptionKernels


_DEVICE: ContextVar[Device | None] = ContextVar("_DEVICE", default=None)


def open_device(name: str) -> Device:
    """The device of a name: `cpu`, `cuda`, `cuda:N`, or `torch-cpu`, which does the work of a GPU on the processor.

    Raises MissingDevice where it is none of these, or not there: nothing else is taken in its place.
    """
    if name == CPU:
        return _processor()
    try:
        from revisit.core.device.torch_description import find_torch_device, torch_description
    except ImportError as missing:
        hint = f"device {name} needs torch, which is not installed: pip install 'revisit-loops[learned]'"
        raise MissingDevice(hint, field="device") from missing
    try:
        return Device(name, torch_description(find_torch_device("cpu" if name == TORCH_ON_CPU else name)))
    except ValueError as error:
        raise MissingDevice(f"device {name}: {error}", field="device") from error


def require_device(name: str) -> None:
    """Raises MissingDevice where `open_device` does. The processor is always there."""
    if name != CPU:
        open_device(name)


@lru_cache(maxsize=1)
def _processor() -> Device:
    from revisit.core.device.compiled_description import compiled_description  # and its compiler, only to compute

    return Device(CPU, compiled_description())


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
