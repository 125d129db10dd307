"""CPU times as ratios to a reference work that is done in between, so that they mean the same on another machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

Work = Callable[[], object]
ROUNDS = 7


@dataclass(frozen=True)
class Timing:
    """CPU seconds of one thread, and the same in units of the reference work: medians over the rounds."""

    seconds: float
    ratio: float


class ReferenceWork:
    """A fixed piece of numerical work of this program's kind, about 0.1 s: neighbours, sorting, Fourier transforms.

    It takes as much memory as a description does, so that a machine whose caches are shared slows both alike.
    """

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._points = rng.normal(size=(30_000, 3)) * (20.0, 20.0, 2.0)
        self._image = rng.normal(size=(250, 250)).astype(np.float32)
        self._keys = rng.integers(0, 2**40, size=400_000)

    def __call__(self) -> None:
        """Do it once."""
        cKDTree(self._points).query(self._points[::2], 8)
        np.argsort(self._keys, kind="stable")
        for _ in range(12):
            np.fft.irfft2(np.fft.rfft2(self._image))


def measure(works: Mapping[str, Work], rounds: int = ROUNDS) -> dict[str, Timing]:
    """Each work once a round, the reference before and after each; the first call of each is not counted."""
    reference = ReferenceWork()
    reference()
    for work in works.values():
        work()
    seconds: dict[str, list[float]] = {name: [] for name in works}
    ratios: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        before = _cpu_seconds(reference)
        for name, work in works.items():
            taken, after = _cpu_seconds(work), _cpu_seconds(reference)
            seconds[name].append(taken)
            ratios[name].append(2.0 * taken / (before + after))
            before = after
    return {name: Timing(float(np.median(seconds[name])), float(np.median(ratios[name]))) for name in works}


def _cpu_seconds(work: Work) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started
