"""The benchmark of the product (`make bench`): speed as ratios, bytes, and surface errors, with a committed baseline.

Quality of recognition has a report of its own: `lab.recognition.benchmark`.
"""

from __future__ import annotations

import json
from pathlib import Path

from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.evaluation.benchmark.metric import Metric, compare, shown
from revisit.evaluation.benchmark.quality import bytes_of, surfaces_and_bytes
from revisit.evaluation.benchmark.speed import (
    CANDIDATES,
    PEERS,
    SEARCHES,
    describing,
    searching,
    two_streets,
    verifying,
)
from revisit.evaluation.benchmark.timing import Timing, measure

__all__ = ["BASELINE", "Metric", "compare", "measure_all", "run"]

BASELINE = Path("docs/reference/benchmark-baseline.json")
STORED = (10_000, 100_000)


def measure_all(stored: tuple[int, ...] = STORED) -> list[Metric]:
    """All metrics, one thread; of a real street, too, where REVISIT_DATA names its folder."""
    models, config, visits = load_packaged_models(), PipelineConfig(), two_streets(CANDIDATES)
    places = tuple(describe(one, models, config) for one in (visits.place, visits.revisit, visits.elsewhere))
    size = len(places[0].descriptor.vector)
    timings = measure(
        {
            **describing(visits, models, config),
            **verifying(visits, places, models, config),
            **{f"search_{count}": searching(count, size) for count in stored},
        }
    )
    return [*_timed(timings), *bytes_of(places[0]), *surfaces_and_bytes()]


def run(baseline: Path = BASELINE, update: bool = False) -> tuple[list[Metric], list[str]]:
    """Measure, compare with the committed baseline, and with `update` write it anew."""
    metrics = measure_all()
    if update:
        baseline.write_text(json.dumps({m.key: round(m.value, 6) for m in metrics}, indent=2) + "\n")
    return metrics, compare(metrics, json.loads(baseline.read_text()))


def _timed(timings: dict[str, Timing]) -> list[Metric]:
    """Seconds, shown, and ratios: those of the product are compared; of a search, the time of one."""
    metrics = []
    for name, timing in timings.items():
        many = SEARCHES if name.startswith("search_") else 1
        metrics.append(shown(name, 1e3 * timing.seconds / many, "CPU ms"))
        ratio = shown if name in PEERS else Metric
        metrics.append(ratio(f"{name}_ratio", timing.ratio / many, "reference work"))
    return metrics
