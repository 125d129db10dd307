"""A LiDAR simulator: ray casting through a procedural town with vegetation, changing parked cars and moving traffic.

streets = grid.streets()                             paths
world = build_city(streets, seed, drive=path)        city
trajectory = drive(path, world.ground)               trajectories
for scan in simulate(world, trajectory, HDL64, seed) lidar
"""

from revisit.evaluation.simulator.city import TownPlan, World, build_city
from revisit.evaluation.simulator.lidar import SimulatedScan, simulate
from revisit.evaluation.simulator.paths import Path, StreetGrid
from revisit.evaluation.simulator.sensors import HDL32, HDL64, OS1_64, SENSORS, VLP16, LidarModel
from revisit.evaluation.simulator.trajectories import Trajectory, drive, grid_drive

__all__ = [
    "HDL32",
    "HDL64",
    "OS1_64",
    "SENSORS",
    "VLP16",
    "LidarModel",
    "Path",
    "SimulatedScan",
    "StreetGrid",
    "TownPlan",
    "Trajectory",
    "World",
    "build_city",
    "drive",
    "grid_drive",
    "simulate",
]  # fmt: skip
