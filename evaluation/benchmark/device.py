"""The cost of a submap on another device, by turns with the processor."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Protocol

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.device import CPU, Device, open_device, using
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe
from revisit.core.submap import Submap
from revisit.evaluation.benchmark.metric import Metric, shown
from revisit.evaluation.benchmark.speed import two_streets

ROUNDS = 5
LEAST_COSINE = 0.9999
SAME_POINT_M = 1e-3
MOST_WORKERS = 4
WORKING_S = 5.0
_STARTING_S = 600.0
"""After which a process that has not answered is given up."""


@dataclass(frozen=True)
class Side:
    """A device and its cost: wall seconds of each round, and the results of the last."""

    device: Device
    seconds: list[float]
    results: list[DescribedPlace]


class Gate(Protocol):
    """Where processes wait for each other."""

    def wait(self) -> object:
        """Returns when all are here."""
        ...


def beside_the_processor(name: str, rounds: int = ROUNDS) -> list[Metric]:
    """Wall milliseconds that a submap takes on the processor and on device `name`, and whether both agree.

    By one process, and by as many side by side as the machine has cores, at most MOST_WORKERS. Raises MissingDevice.
    """
    other = open_device(name)
    models, config, visits = load_packaged_models(), PipelineConfig(), two_streets()
    submaps = visits.revisit, visits.place, visits.elsewhere

    def described(device: Device) -> list[DescribedPlace]:
        with using(device):
            return [describe(submap, models, config) for submap in submaps]

    sides = _by_turns(other, described, rounds)
    pairs = list(zip(*(side.results for side in sides), strict=True))
    return [
        *(shown(f"describe_on_{side.device.name}", _each_ms(side, len(submaps)), "wall ms") for side in sides),
        *(_side_by_side(side.device.name, submaps, _workers()) for side in sides),
        shown("descriptors_apart", 1e6 * (1.0 - min(_cosine(*pair) for pair in pairs)), "1e-6 of cosine"),
        shown("descriptions_that_differ", sum(not _alike(*pair) for pair in pairs), "submaps"),
    ]


def _by_turns(other: Device, work: Callable[[Device], list[DescribedPlace]], rounds: int) -> list[Side]:
    """The processor and another device at the same work."""
    sides = [Side(open_device(CPU), [], []), Side(other, [], [])]
    for turn in range(1 + rounds):  # the first compiles and is not counted
        for side in sides:
            started = time.perf_counter()
            side.results[:] = work(side.device)
            side.seconds.extend([time.perf_counter() - started] if turn else [])
    return sides


def _each_ms(side: Side, submaps: int) -> float:
    """Milliseconds of the median round for one of its submaps."""
    return 1e3 * float(np.median(side.seconds)) / submaps


def _workers() -> int:
    return min(MOST_WORKERS, os.cpu_count() or 1)


def _side_by_side(name: str, submaps: Sequence[Submap], workers: int) -> Metric:
    """Wall milliseconds until the next of all submaps that so many processes describe on device `name`."""
    context = get_context("spawn")
    gate, counts = context.Barrier(workers), context.Queue()
    at_work = (name, submaps, WORKING_S, gate, counts.put)
    processes = [context.Process(target=count_described, args=at_work, daemon=True) for _ in range(workers)]
    for process in processes:
        process.start()
    done = 0
    try:
        for _ in processes:
            told = counts.get(timeout=_STARTING_S)
            if isinstance(told, Exception):
                raise told
            done += told
    finally:
        for process in processes:
            process.kill()
            process.join()
    return shown(f"describe_by_{workers}_on_{name}", 1e3 * WORKING_S / done, "wall ms")


def count_described(
    name: str, submaps: Sequence[Submap], seconds: float, gate: Gate, tell: Callable[[int | Exception], None]
) -> None:
    """Describe the submaps on device `name` once, then over and over for so long from when all wait at the gate; tell
    how many it were, or the error.
    """
    try:
        tell(_described(open_device(name), submaps, seconds, gate))
    except Exception as error:  # noqa: BLE001 - whatever it is: who waits for the number must know
        tell(error)


def _described(device: Device, submaps: Sequence[Submap], seconds: float, gate: Gate) -> int:
    models, config = load_packaged_models(), PipelineConfig()
    count = 0
    with using(device):
        for submap in submaps:
            describe(submap, models, config)
        gate.wait()
        end = time.perf_counter() + seconds
        while not count or time.perf_counter() < end:
            describe(submaps[count % len(submaps)], models, config)
            count += 1
    return count


def _cosine(one: DescribedPlace, other: DescribedPlace) -> float:
    return float(one.descriptor.vector @ other.descriptor.vector)


def _alike(one: DescribedPlace, other: DescribedPlace) -> bool:
    """Whether two descriptions of a submap are the same within the tolerance of devices (docs/decisions/0295)."""
    points, others = one.neural_map.points.positions, other.neural_map.points.positions
    if _cosine(one, other) < LEAST_COSINE or len(points) != len(others):
        return False
    return bool(np.abs(points - others).max(initial=0.0) <= SAME_POINT_M)
