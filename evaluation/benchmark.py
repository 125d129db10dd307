"""`revisit bench`: the declared metrics of one machine against the committed baseline.

Where REVISIT_DATA names the folder of real recordings, surface error and map size are also measured on real scans.
Quality is compared tightly. Times are divided by the time of a fixed piece of numerical work on the same machine, so
that a slower computer does not look like a slower program; the seconds are shown beside.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.index import FaissIndex, IndexEntry, SearchFilter
from revisit.core.model_bundle import ModelBundle, load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe, verify
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.cutting import cut, load_submap
from revisit.evaluation.datasets import KittiRecording
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.simulator import HDL64, StreetGrid, build_city, drive, grid_drive, simulate

Result = TypeVar("Result")

BASELINE = Path("docs/reference/benchmark-baseline.json")
STORED_DESCRIPTORS = 10_000
QUERIES = 500
TOWN_SEED = 4_711
REAL_SUBMAPS = 8


@dataclass(frozen=True)
class Metric:
    """One declared figure. `worse` is the direction of a regression, `tolerance` the relative change that is noise."""

    key: str
    value: float
    unit: str
    worse: str
    tolerance: float


def measure() -> list[Metric]:
    """All metrics on 10 m submaps of a 64-beam sensor, one thread: simulated ones, and real ones where there are."""
    torch.set_num_threads(1)
    unit_s = _reference_seconds()
    first, second = _two_visits()
    models, config = load_packaged_models(), PipelineConfig()
    describe(first, models, config)
    described, describe_s = _best_of(3, lambda: describe(first, models, config))
    other = describe(second, models, config)
    similarity = described.descriptor.similarity(other.descriptor)
    _, verify_s = _best_of(3, lambda: verify(other.place, described.place, similarity, config.verification))
    query_p99_s = _query_p99_seconds(len(described.descriptor.vector))
    return [
        *_quality(first, described),
        *_real_quality(models, config),
        Metric("describe", describe_s, "CPU s", "up", np.inf),
        Metric("describe_ratio", describe_s / unit_s, "reference work", "up", 0.35),
        Metric("verify", verify_s, "CPU s", "up", np.inf),
        Metric("verify_ratio", verify_s / unit_s, "reference work", "up", 0.5),
        Metric("query_p99", 1e3 * query_p99_s, "ms over 10,000 descriptors", "up", np.inf),
        Metric("query_p99_ratio", query_p99_s / unit_s, "reference work", "up", 1.0),
    ]


def compare(metrics: list[Metric], baseline: dict[str, float]) -> list[str]:
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


def run(baseline: Path = BASELINE, update: bool = False) -> tuple[list[Metric], list[str]]:
    """Measure, compare with the committed baseline, and with `update` write it anew."""
    metrics = measure()
    if update:
        known = json.loads(baseline.read_text()) if baseline.exists() else {}
        baseline.write_text(json.dumps(known | {m.key: round(m.value, 6) for m in metrics}, indent=2) + "\n")
    return metrics, compare(metrics, json.loads(baseline.read_text()))


def _quality(submap: Submap, described: DescribedPlace) -> list[Metric]:
    distance = _distances(submap, described)
    return [
        Metric("surface_error_median", float(np.median(distance)), "m", "up", 0.1),
        Metric("surface_error_p90", float(np.percentile(distance, 90)), "m", "up", 0.1),
        Metric("neural_map_share", _map_share(submap, described), "of the raw float32 cloud", "up", 0.1),
        Metric("signature", len(described.place.to_blob()) / 1e3, "kB", "up", 0.1),
    ]


def _real_quality(models: ModelBundle, config: PipelineConfig) -> list[Metric]:
    """Surface error and map size over submaps spread along the real street."""
    if "REVISIT_DATA" not in os.environ:
        return []
    script = Path(os.environ["REVISIT_DATA"]) / "unpack.py"
    with tempfile.TemporaryDirectory() as folder:
        street = Path(folder) / "street"
        subprocess.run([sys.executable, script, "kitti00_head", street], check=True, stdout=subprocess.DEVNULL)
        recording = KittiRecording(street)
        windows = cut(recording, config.submap)
        spread = [windows[round(place)] for place in np.linspace(0, len(windows) - 1, REAL_SUBMAPS)]
        submaps = [load_submap(recording, window, config.submap, Perturbation())[0] for window in spread]
    places = [describe(submap, models, config) for submap in submaps]
    distance = np.concatenate([_distances(*pair) for pair in zip(submaps, places, strict=True)])
    share = float(np.mean([_map_share(*pair) for pair in zip(submaps, places, strict=True)]))
    return [
        Metric("real_surface_error_median", float(np.median(distance)), "m", "up", 0.1),
        Metric("real_surface_error_p90", float(np.percentile(distance, 90)), "m", "up", 0.1),
        Metric("real_neural_map_share", share, "of the raw float32 cloud", "up", 0.1),
    ]


def _distances(submap: Submap, described: DescribedPlace) -> NDArray[np.float32]:
    """Distances (n,) in metres of a sample of the returns to the surface of the neural map."""
    sample = submap.levelled().points[:: max(1, len(submap.points) // 40_000)]
    return np.abs(described.neural_map.sdf(sample)[0])


def _map_share(submap: Submap, described: DescribedPlace) -> float:
    return len(described.neural_map.to_blob()) / (12 * len(submap.points))


def _two_visits() -> tuple[Submap, Submap]:
    """Two 10 m submaps of the same simulated street, in opposite lanes and directions, scans every metre."""
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    path = grid_drive(grid, [(0, 0), (1, 0), (2, 0), (1, 0), (0, 0)])
    trajectory = drive(path, world.ground, lane_m=1.8, spacing_m=1.0)
    middle = round(len(trajectory) * 0.25), round(len(trajectory) * 0.75)
    scans = list(simulate(world, trajectory, HDL64, TOWN_SEED))
    visits = [[Scan.validated(s.points, s.T_world_sensor, s.stamp_ns) for s in scans[m - 5 : m + 6]] for m in middle]
    return Submap.from_scans(visits[0], SubmapConfig()), Submap.from_scans(visits[1], SubmapConfig())


def _query_p99_seconds(dimension: int) -> float:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(STORED_DESCRIPTORS, dimension)).astype(np.float32)
    index = FaissIndex(dimension)
    index.add([IndexEntry(i, i // 500, i % 500, np.zeros(3)) for i in range(STORED_DESCRIPTORS)], vectors)
    seconds = []
    for query in rng.normal(size=(QUERIES, dimension)).astype(np.float32):
        started = time.perf_counter()
        index.search(query, 20, SearchFilter(near=(0, 250, 50)))
        seconds.append(time.perf_counter() - started)
    return float(np.percentile(seconds, 99))


def _reference_seconds() -> float:
    """Time of a fixed piece of numerical work of this program's kind: sorting and small eigenproblems."""
    rng = np.random.default_rng(0)
    numbers, matrices = rng.normal(size=2_000_000), rng.normal(size=(20_000, 3, 3))
    return _best_of(5, lambda: (np.sort(numbers), np.linalg.eigh(matrices)))[1]


def _best_of(times: int, work: Callable[[], Result]) -> tuple[Result, float]:
    """The result of `work` and the least of `times` runs in seconds of this process's CPU."""
    best = np.inf
    for _ in range(times):
        started = time.process_time()
        result = work()
        best = min(best, time.process_time() - started)
    return result, float(best)
