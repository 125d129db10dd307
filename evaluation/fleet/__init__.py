"""A simulated fleet: three robots on two days in one town, wrong loops for its map, and how far that is from the truth.

drives = fleet_drives(seed)                            drives
wrong = random_loops(...) or agreeing_loops(...)       wrong_loops
score = scored(poses, truth); ate_m(...)               scores
draw(figure, file)                                     figure
"""

from revisit.evaluation.fleet.drives import FleetDrive, fleet_drives
from revisit.evaluation.fleet.figure import FleetFigure, draw
from revisit.evaluation.fleet.scores import FleetOutcome, aligned, ate_m, poses_without_wrong_loops, table
from revisit.evaluation.fleet.wrong_loops import PlacedSubmap, agreeing_loops, random_loops

__all__ = [
    "FleetDrive", "FleetFigure", "FleetOutcome", "PlacedSubmap", "agreeing_loops", "aligned", "ate_m", "draw",
    "fleet_drives", "poses_without_wrong_loops", "random_loops", "table",
]  # fmt: skip
