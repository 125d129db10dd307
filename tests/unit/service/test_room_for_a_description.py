"""What a worker holds while it describes a submap (docs/decisions/0289)."""

from __future__ import annotations

import weakref

import numpy as np

from revisit.core import pipeline
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.service.adapters.core_recogniser import CoreRecogniser
from tests.support.block_worlds import along, seen, yard

CONFIG = PipelineConfig()


def test_the_points_of_a_submap_are_gone_when_its_surface_is_sought(monkeypatch) -> None:
    drive = seen(yard(1, False), along((-20, 0), (-10, 0)), 1)
    leaning = se3.exp(np.array([0.0, 0.0, 0.0, 0.02, 0.01, 0.0]))
    scans = [
        Scan.validated(points, leaning @ T_world_sensor, n * 10**9) for n, (points, T_world_sensor) in enumerate(drive)
    ]
    held, extract_surface = list[Submap | None](), pipeline.extract_surface
    submaps: list[weakref.ref[Submap]] = []

    def upright() -> Submap:
        submap = Submap.from_scans(scans, CONFIG.submap).levelled(in_place=True)
        submaps.append(weakref.ref(submap))
        return submap

    def looks_around(*arguments):
        held.extend(submap() for submap in submaps)
        return extract_surface(*arguments)

    monkeypatch.setattr(pipeline, "extract_surface", looks_around)
    CoreRecogniser().describe(upright(), CONFIG)
    assert held == [None]
