"""Devices: which one is in use, and one that is missing is named."""

from __future__ import annotations

import sys

import pytest

from revisit.core.device import CPU, TORCH_ON_CPU, MissingDevice, device, open_device, use, using

pytest.importorskip("torch", reason="devices but the processor need torch")


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "mps", "meta", ""])
def test_a_device_that_is_not_there_is_named(name):
    with pytest.raises(MissingDevice, match=f"device {name}"):
        open_device(name)


def test_without_torch_the_processor_works_and_other_devices_name_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for module in [name for name in sys.modules if name.startswith("revisit.core.device.torch")]:
        monkeypatch.delitem(sys.modules, module)
    assert open_device(CPU).name == CPU
    with pytest.raises(MissingDevice, match=r"revisit-loops\[learned\]"):
        open_device(TORCH_ON_CPU)


def test_the_device_is_the_processor_until_another_is_chosen():
    assert device().name == CPU
    with using(open_device(TORCH_ON_CPU)):
        assert device().name == TORCH_ON_CPU
    assert device().name == CPU
    use(open_device(CPU))
    assert device().name == CPU
