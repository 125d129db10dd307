"""What a submap and a query's candidates cost on another device, beside the processor and by turns with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.device import CPU, Device, at_once, open_device, using
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe, verify
from revisit.core.place import Place
from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.evaluation.benchmark.metric import Metric, shown
from revisit.evaluation.benchmark.speed import two_streets

CANDIDATES = 20
ROUNDS = 5
SAME_M = 1e-6
LEAST_COSINE = 0.9999
SAME_POINT_M = 1e-3

Verdict = VerifiedLoop | RejectedLoop
Result = TypeVar("Result")


@dataclass(frozen=True)
class Side(Generic[Result]):
    """A device, and what it took: wall seconds of each round, and the results of the last."""

    device: Device
    seconds: list[float]
    results: list[Result]


def beside_the_processor(name: str, rounds: int = ROUNDS) -> list[Metric]:
    """Wall milliseconds on the processor and on device `name`, and whether both agree: of a submap that is described,
    and of a query with 20 candidates.

    Every second candidate is the same place. All are read from their stored form in each round, the query too. Raises
    MissingDevice.
    """
    other = open_device(name)
    models, config, visits = load_packaged_models(), PipelineConfig(), two_streets()
    submaps = visits.revisit, visits.place, visits.elsewhere

    def described(device: Device) -> list[DescribedPlace]:
        with using(device):
            return [describe(submap, models, config) for submap in submaps]

    described_by = _by_turns(other, described, rounds)
    query, *matches = (one.place.to_blob() for one in described_by[0].results)
    blobs = [matches[number % 2] for number in range(CANDIDATES)]
    verified_by = _by_turns(other, lambda device: _query(device, query, blobs, config), rounds)
    described_pairs = list(zip(*(side.results for side in described_by), strict=True))
    return [
        *_times("describe", described_by, len(submaps)),
        shown("descriptors_apart", 1e6 * (1.0 - min(_cosine(*pair) for pair in described_pairs)), "1e-6 of cosine"),
        shown("descriptions_that_differ", sum(not _alike(*pair) for pair in described_pairs), "submaps"),
        *_times(f"verify_{CANDIDATES}", verified_by, 1),
        shown("verdicts_that_differ", _different(*(side.results for side in verified_by)), "candidates"),
    ]


def _by_turns(other: Device, work: Callable[[Device], list[Result]], rounds: int) -> list[Side[Result]]:
    """The processor and another device at the same work."""
    sides: list[Side[Result]] = [Side(open_device(CPU), [], []), Side(other, [], [])]
    for turn in range(1 + rounds):  # the first compiles and is not counted
        for side in sides:
            seconds, side.results[:] = _timed(partial(work, side.device))
            side.seconds.extend([seconds] if turn else [])
    return sides


def _times(key: str, sides: Sequence[Side[Result]], each: int) -> list[Metric]:
    """The median of each side for one of the `each` things that it did in a round."""
    return [
        shown(f"{key}_on_{side.device.name}", 1e3 * float(np.median(side.seconds)) / each, "wall ms") for side in sides
    ]


def _cosine(one: DescribedPlace, other: DescribedPlace) -> float:
    return float(one.descriptor.vector @ other.descriptor.vector)


def _alike(one: DescribedPlace, other: DescribedPlace) -> bool:
    """Whether two descriptions of a submap are the same within what is promised of devices (docs/decisions/0219)."""
    points, others = one.neural_map.points.positions, other.neural_map.points.positions
    if _cosine(one, other) < LEAST_COSINE or len(points) != len(others):
        return False
    return bool(np.abs(points - others).max(initial=0.0) <= SAME_POINT_M)


def _query(device: Device, query: bytes, blobs: Sequence[bytes], config: PipelineConfig) -> list[Verdict]:
    asked = Place.from_blob(query)
    with using(device):
        return at_once([partial(verify, asked, Place.from_blob(one), 0.9, config.verification) for one in blobs])


def _timed(work: Callable[[], list[Result]]) -> tuple[float, list[Result]]:
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def _different(first: Sequence[Verdict], second: Sequence[Verdict]) -> int:
    """How many verdicts have another outcome or reason, or a pose that is off by more than SAME_M metres."""
    return sum(not _agree(one, other) for one, other in zip(first, second, strict=True))


def _agree(one: Verdict, other: Verdict) -> bool:
    reasons = [verdict.reason if isinstance(verdict, RejectedLoop) else None for verdict in (one, other)]
    if reasons[0] != reasons[1] or one.measurement is None or other.measurement is None:
        return reasons[0] == reasons[1] and one.measurement is other.measurement
    return bool(np.allclose(one.measurement.T_match_query, other.measurement.T_match_query, rtol=0.0, atol=SAME_M))
