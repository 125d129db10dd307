"""Scan Context beside the product, on the same submaps; `lab.baselines` holds further methods."""

from revisit.evaluation.baselines.place_recogniser import Descriptor, PlaceRecogniser
from revisit.evaluation.baselines.scan_context import ScanContext

__all__ = ["Descriptor", "PlaceRecogniser", "ScanContext"]
