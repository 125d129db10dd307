"""The demonstration: a simulated robot's drive, its truth, and a picture of the result."""

from revisit.evaluation.demo.drive import DemoDrive, demo_drives
from revisit.evaluation.demo.figure import DemoFigure, draw
from revisit.evaluation.demo.map_errors import MapReport, RobotTrack, judge_map
from revisit.evaluation.demo.pair import ClosingPair, PairClouds, closing_pair
from revisit.evaluation.demo.portrait import Portrait, portray
from revisit.evaluation.demo.truth import FoundLoop, LoopReport, Targets, TrueSubmap, compare

__all__ = [
    "ClosingPair", "DemoDrive", "DemoFigure", "FoundLoop", "LoopReport", "MapReport", "PairClouds", "Portrait",
    "RobotTrack", "Targets", "TrueSubmap", "closing_pair", "compare", "demo_drives", "draw", "judge_map", "portray",
]  # fmt: skip
