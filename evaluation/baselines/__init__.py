"""Other methods to compare with, re-implemented from their papers and run on the same submaps."""

from evaluation.baselines.m2dp import M2dp
from evaluation.baselines.place_recogniser import PlaceRecogniser
from evaluation.baselines.ring import Ring
from evaluation.baselines.scan_context import ScanContext

__all__ = ["M2dp", "PlaceRecogniser", "Ring", "ScanContext"]
