"""The demonstration: a simulated robot's drive, what is true about it, and a picture of what was found."""

from revisit.evaluation.demo.drive import DemoDrive, demo_drives
from revisit.evaluation.demo.figure import DemoFigure, draw
from revisit.evaluation.demo.portrait import Portrait, portray
from revisit.evaluation.demo.truth import FoundLoop, LoopReport, Targets, TrueSubmap, compare

__all__ = [
    "DemoDrive", "DemoFigure", "FoundLoop", "LoopReport", "Portrait", "Targets", "TrueSubmap", "compare",
    "demo_drives", "draw", "portray",
]  # fmt: skip
