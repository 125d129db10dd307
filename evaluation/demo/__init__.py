"""The demonstration: a simulated robot's drive, what is true about it, and a picture of what was found."""

from evaluation.demo.drive import DemoDrive, demo_drives
from evaluation.demo.figure import DemoFigure, draw
from evaluation.demo.portrait import Portrait, portray
from evaluation.demo.truth import FoundLoop, LoopReport, Targets, TrueSubmap, compare

__all__ = [
    "DemoDrive", "DemoFigure", "FoundLoop", "LoopReport", "Portrait", "Targets", "TrueSubmap", "compare",
    "demo_drives", "draw", "portray",
]  # fmt: skip
