"""The container of stored numbers: what it wrote comes back, anything else is refused."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest

from revisit.core.codec.container import Container
from revisit.core.errors import DataLoss

PLAIN = Container(b"TEST\x01", "test blob", level=3, max_body_bytes=1_000_000)
SIZED = dataclasses.replace(PLAIN, digest_bytes=16, body_length=True)


@pytest.mark.parametrize("container", [PLAIN, SIZED])
def test_what_was_packed_comes_back(container):
    body = np.random.default_rng(0).bytes(5000)
    assert container.unpack(container.pack({"a": [1, 2.5]}, body)) == ({"a": [1, 2.5]}, body)


@pytest.mark.parametrize("container", [PLAIN, SIZED])
def test_every_flipped_or_missing_byte_is_noticed(container):
    blob = container.pack({"a": 1}, b"some numbers")
    for position in range(len(blob)):
        damaged = bytearray(blob)
        damaged[position] ^= 1
        with pytest.raises(DataLoss):
            container.unpack(bytes(damaged))
        with pytest.raises(DataLoss):
            container.unpack(blob[:position])


@pytest.mark.parametrize("container", [PLAIN, SIZED])
def test_a_body_that_unpacks_to_more_than_the_bound_is_refused_without_the_memory(container):
    bomb = dataclasses.replace(container, max_body_bytes=2**30).pack({}, bytes(100_000_000))
    tracemalloc.start()
    try:
        with pytest.raises(DataLoss, match="too large"):
            container.unpack(bomb)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
