"""What a query's candidates cost on another device, beside the processor and by turns with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.device import CPU, Device, at_once, open_device, using
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe, verify
from revisit.core.place import Place
from revisit.core.submap import Submap
from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.evaluation.benchmark.metric import Metric, shown
from revisit.evaluation.benchmark.speed import two_streets

CANDIDATES = 20
ROUNDS = 5
SAME_M = 1e-6

Verdict = VerifiedLoop | RejectedLoop


@dataclass(frozen=True)
class Side:
    """A device, and what it took: wall seconds of each round, and the verdicts of the last."""

    device: Device
    seconds: list[float]
    verdicts: list[Verdict]


def beside_the_processor(name: str, rounds: int = ROUNDS) -> list[Metric]:
    """Wall milliseconds of a query with 20 candidates on the processor and on device `name`, and whether both agree.

    Every second candidate is the same place. All are read from their stored form in each round, the query too. Raises
    MissingDevice.
    """
    other = open_device(name)
    models, config, visits = load_packaged_models(), PipelineConfig(), two_streets()

    def stored(submap: Submap) -> bytes:
        return describe(submap, models, config).place.to_blob()

    query, matches = stored(visits.revisit), (stored(visits.place), stored(visits.elsewhere))
    blobs = [matches[number % 2] for number in range(CANDIDATES)]
    sides = [Side(open_device(CPU), [], []), Side(other, [], [])]
    for turn in range(1 + rounds):  # the first compiles and is not counted
        for side in sides:
            seconds, side.verdicts[:] = _timed(partial(_query, side.device, query, blobs, config))
            side.seconds.extend([seconds] if turn else [])
    times = [
        shown(f"verify_{CANDIDATES}_on_{side.device.name}", 1e3 * float(np.median(side.seconds)), "wall ms")
        for side in sides
    ]
    return [*times, shown("verdicts_that_differ", _different(*(side.verdicts for side in sides)), "candidates")]


def _query(device: Device, query: bytes, blobs: Sequence[bytes], config: PipelineConfig) -> list[Verdict]:
    asked = Place.from_blob(query)
    with using(device):
        return at_once([partial(verify, asked, Place.from_blob(one), 0.9, config.verification) for one in blobs])


def _timed(work: Callable[[], list[Verdict]]) -> tuple[float, list[Verdict]]:
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
