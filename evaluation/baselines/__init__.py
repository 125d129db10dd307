"""Other methods to compare with, re-implemented from their papers and run on the same submaps."""

from evaluation.baselines.lidar_iris import LidarIris
from evaluation.baselines.m2dp import M2dp
from evaluation.baselines.ndt_histogram import NdtHistogram
from evaluation.baselines.place_recogniser import Descriptor, PlaceRecogniser
from evaluation.baselines.ring import Ring
from evaluation.baselines.ring_plus_plus import RingPlusPlus
from evaluation.baselines.scan_context import ScanContext
from evaluation.baselines.solid import Solid
from evaluation.baselines.triangles import Triangles

__all__ = [
    "ALL_BASELINES", "Descriptor", "LidarIris", "M2dp", "NdtHistogram", "PlaceRecogniser", "Ring", "RingPlusPlus",
    "ScanContext", "Solid", "Triangles",
]  # fmt: skip

ALL_BASELINES: tuple[PlaceRecogniser, ...] = (
    ScanContext(), M2dp(), NdtHistogram(), Ring(), RingPlusPlus(), Solid(), LidarIris(), Triangles()
)  # fmt: skip
"""Every baseline with the parameters of its paper, or what its docstring says instead."""
