"""Chains of small steps that a GPU does as one: recorded once for each size, then replayed (CUDA graphs).

A step on a hundred thousand rows takes a GPU some microseconds, and the processor three times as long to ask for it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import torch
from torch import Tensor

Steps = Callable[..., tuple[Tensor, ...]]

_FEWEST_ROWS = 1 << 10


class _Recording(NamedTuple):
    """A graph, its inputs and its outputs."""

    graph: torch.cuda.CUDAGraph
    given: tuple[Tensor, ...]
    found: tuple[Tensor, ...]


def replayed(steps: Steps) -> Steps:
    """`steps` as they are on a processor; on a GPU recorded, and replayed for as many rows as there are.

    They take columns (n, ...) and constants by name, and give columns (n, ...). A row of the result hangs on that
    row of the input alone, and nothing that they do may wait for the GPU.
    """
    recordings: dict[tuple[object, ...], _Recording] = {}

    @wraps(steps)
    def replay(*columns: Tensor, **constants: float) -> tuple[Tensor, ...]:
        rows = len(columns[0])
        if columns[0].device.type != "cuda" or rows == 0:
            return steps(*columns, **constants)
        room = max(_FEWEST_ROWS, 1 << (rows - 1).bit_length())
        kinds = tuple((column.device, column.dtype, column.shape[1:]) for column in columns)
        key = (room, kinds, *sorted(constants.items()))
        if key not in recordings:
            recordings[key] = _recorded(steps, columns, room, constants)
        graph, given, found = recordings[key]
        for place, column in zip(given, columns, strict=True):
            place[:rows].copy_(column)
        graph.replay()
        return tuple(column[:rows].clone() for column in found)

    return replay


def _recorded(steps: Steps, columns: tuple[Tensor, ...], room: int, constants: dict[str, float]) -> _Recording:
    """The steps on `room` rows; they are done once before, so that libraries are there."""
    with torch.cuda.device(columns[0].device):
        given = tuple(torch.ones((room, *one.shape[1:]), dtype=one.dtype, device=one.device) for one in columns)
        beside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):
            steps(*given, **constants)
        torch.cuda.current_stream().wait_stream(beside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            found = steps(*given, **constants)
    return _Recording(graph, given, found)
