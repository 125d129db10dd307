"""Other methods to compare with, re-implemented from their papers and run on the same submaps."""

from __future__ import annotations

from lab.baselines.augmented_scan_context import AugmentedScanContext
from lab.baselines.lidar_iris import LidarIris
from lab.baselines.m2dp import M2dp
from lab.baselines.ndt_histogram import NdtHistogram
from lab.baselines.ring import Ring
from lab.baselines.ring_plus_plus import RingPlusPlus
from lab.baselines.solid import Solid
from lab.baselines.stable_triangles import StableTriangles
from lab.baselines.triangles import Triangles
from revisit.evaluation.baselines import PlaceRecogniser, ScanContext

ALL_BASELINES: tuple[PlaceRecogniser, ...] = (
    ScanContext(), M2dp(), NdtHistogram(), Ring(), RingPlusPlus(), Solid(), LidarIris(), Triangles(),
    AugmentedScanContext(), StableTriangles(),
)  # fmt: skip
"""Every baseline with the parameters of its paper, or those of its docstring."""
