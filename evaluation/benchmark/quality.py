"""Surface errors by true distance, and stored bytes: simulated, and of a real street where there is one."""

from __future__ import annotations

import tempfile
from pathlib import Path

from revisit.core.config import ImplicitMapConfig
from revisit.core.pipeline import DescribedPlace
from revisit.evaluation.benchmark.metric import Metric
from revisit.evaluation.surfaces.bench import measure
from revisit.evaluation.surfaces.scenes import scene_groups

_SCENES = {
    "town (simulated, HDL-64)": "town",
    "street (real, HDL-64)": "street",
    "street (real, 16 beams)": "street_16",
}


def surfaces_and_bytes() -> list[Metric]:
    """Mean distance from the stored surface to the truth and back, and the map's share of the raw float32 cloud.

    The share is of submaps with scans held out, and so larger than that of whole ones.
    """
    with tempfile.TemporaryDirectory() as folder:
        groups = scene_groups(Path(folder), count=1)
    rows = {
        _SCENES[name]: measure(name, "", scenes, ImplicitMapConfig())
        for name, scenes in groups.items()
        if name in _SCENES
    }
    return [
        metric
        for name, row in rows.items()
        for metric in (
            Metric(f"surface_error_{name}", row.error.mean, "m, mean both ways", tolerance=0.1),
            Metric(f"neural_map_share_{name}", row.share, "of the raw float32 cloud", tolerance=0.1),
        )
    ]


def bytes_of(described: DescribedPlace) -> list[Metric]:
    """The stored bytes of a simulated submap of 11 scans."""
    return [
        Metric("neural_map", len(described.neural_map.to_blob()) / 1e3, "kB", tolerance=0.1),
        Metric("place", len(described.place.to_blob()) / 1e3, "kB", tolerance=0.1),
    ]
