"""Declared figures, and their regressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

NOISE = 0.15
"""Relative change of a ratio that is no regression."""


@dataclass(frozen=True)
class Metric:
    """One declared figure. `worse` is the direction of a regression, `tolerance` the relative change that is noise.

    Figures in seconds depend on the machine: they are shown, and their tolerance is infinite.
    """

    key: str
    value: float
    unit: str
    worse: str = "up"
    tolerance: float = NOISE


def shown(key: str, value: float, unit: str) -> Metric:
    """A figure that is shown only."""
    return Metric(key, value, unit, tolerance=np.inf)


def compare(metrics: Sequence[Metric], baseline: Mapping[str, float]) -> list[str]:
    """The regressions against `baseline`, as sentences; empty where there are none."""
    found = []
    for metric in metrics:
        if metric.key not in baseline:
            continue
        known = baseline[metric.key]
        change = (metric.value - known) / abs(known) if known else 0.0
        if (change if metric.worse == "up" else -change) > metric.tolerance:
            found.append(f"{metric.key}: {metric.value:.4g} {metric.unit}, baseline {known:.4g} ({change:+.0%})")
    return found
