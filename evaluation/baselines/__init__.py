"""Other methods to compare with, re-implemented from their papers and run on the same submaps."""

from revisit.evaluation.baselines.augmented_scan_context import AugmentedScanContext
from revisit.evaluation.baselines.lidar_iris import LidarIris
from revisit.evaluation.baselines.m2dp import M2dp
from revisit.evaluation.baselines.ndt_histogram import NdtHistogram
from revisit.evaluation.baselines.place_recogniser import Descriptor, PlaceRecogniser
from revisit.evaluation.baselines.ring import Ring
from revisit.evaluation.baselines.ring_plus_plus import RingPlusPlus
from revisit.evaluation.baselines.scan_context import ScanContext
from revisit.evaluation.baselines.solid import Solid
from revisit.evaluation.baselines.stable_triangles import StableTriangles
from revisit.evaluation.baselines.triangles import Triangles

__all__ = [
    "ALL_BASELINES", "AugmentedScanContext", "Descriptor", "LidarIris", "M2dp", "NdtHistogram", "PlaceRecogniser",
    "Ring", "RingPlusPlus", "ScanContext", "Solid", "StableTriangles", "Triangles",
]  # fmt: skip

ALL_BASELINES: tuple[PlaceRecogniser, ...] = (
    ScanContext(), M2dp(), NdtHistogram(), Ring(), RingPlusPlus(), Solid(), LidarIris(), Triangles(),
    AugmentedScanContext(), StableTriangles(),
)  # fmt: skip
"""Every baseline with the parameters of its paper, or what its docstring says instead."""
