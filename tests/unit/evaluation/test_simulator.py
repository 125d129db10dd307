"""The simulator: geometry it must reproduce, labels, sensors, determinism. All data here is simulated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lab.worlds.recorded_ways import kitti_path, streets_under
from revisit.core.geometry import se3
from revisit.evaluation.simulator import OS1_64, SENSORS, VLP16, Path, TownPlan, Trajectory, build_city, drive, simulate
from revisit.evaluation.simulator.blocks import Material, block
from revisit.evaluation.simulator.city import World
from revisit.evaluation.simulator.paths import StreetGrid
from revisit.evaluation.simulator.sensors import LidarModel
from revisit.evaluation.simulator.traffic import ParkedCars, ParkingSlots, Traffic
from revisit.evaluation.simulator.trajectories import grid_drive

STREET = Path.through([[0.0, 0.0], [80.0, 0.0]])
EXACT = LidarModel("exact", (-45.0, -30.0, 0.0), 4, 0.5, 100.0, 0.0, 1e6, 0.0)


@pytest.fixture(scope="module")
def town() -> World:
    return build_city([STREET], seed=5, drive=STREET)


def flat_world(*, traffic: Traffic | None = None, slots: ParkingSlots | None = None) -> World:
    """Ground at z = 0 and one wall, the plane x = 10, without anything else."""
    plan = TownPlan(relief=0.0, kerb_height=0.0)
    world = build_city([STREET], seed=0, plan=plan)
    ground = block((0, 0, -1), (400, 400, 1), Material.GROUND)
    wall = block((10.5, 0, 0), (1, 100, 50), Material.WALL)
    triangles = np.concatenate([ground.triangles(), wall.triangles()])
    materials = np.concatenate([ground.triangle_materials(), wall.triangle_materials()])
    nobody = Traffic((), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    empty = ParkingSlots(np.zeros((0, 3)), np.zeros(0), 1.0, 0)
    return dataclasses.replace(
        world, triangles=triangles, materials=materials, traffic=traffic or nobody, parking=slots or empty
    )


def standing_at(
    position: tuple[float, float, float], yaw: float = 0.0, times_s: tuple[float, ...] = (0.0,)
) -> Trajectory:
    pose = se3.from_yaw(yaw, position)
    return Trajectory(np.stack([pose] * len(times_s)), (np.array(times_s) * 1e9).astype(np.int64))


def test_a_noise_free_sensor_measures_the_known_distance_to_the_wall_and_the_ground() -> None:
    scan = next(simulate(flat_world(), standing_at((0.0, 0.0, 2.0)), EXACT, seed=0))
    # The level beam ahead meets the wall x = 10; the beam at -45 degrees meets the ground 2 m below.
    ahead = scan.points[scan.beam == 2]
    assert np.abs(ahead - [10.0, 0.0, 0.0]).max(axis=1).min() < 1e-4
    steep = scan.points[scan.beam == 0]
    assert len(steep) == 4
    np.testing.assert_allclose(np.linalg.norm(steep, axis=1), 2.0 * np.sqrt(2.0), atol=1e-4)


def test_points_are_given_in_the_frame_of_the_turned_sensor() -> None:
    scan = next(simulate(flat_world(), standing_at((0.0, 0.0, 2.0), yaw=np.pi / 2), EXACT, seed=0))
    # Heading along +y, the wall x = 10 lies to the right: at y = -10 in the sensor frame.
    level = scan.points[scan.beam == 2]
    assert np.abs(level - [0.0, -10.0, 0.0]).max(axis=1).min() < 1e-4


def test_the_same_seed_gives_the_same_scan_and_another_seed_another(town: World) -> None:
    trajectory = drive(STREET, town.ground, spacing_m=40.0)
    first = [scan.points for scan in simulate(town, trajectory, VLP16, seed=1)]
    again = [scan.points for scan in simulate(build_city([STREET], seed=5, drive=STREET), trajectory, VLP16, seed=1)]
    other = [scan.points for scan in simulate(town, trajectory, VLP16, seed=2)]
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_another_city_seed_builds_another_town(town: World) -> None:
    other = build_city([STREET], seed=6, drive=STREET)
    assert other.triangles.shape != town.triangles.shape or not np.array_equal(other.triangles, town.triangles)


@pytest.mark.parametrize(("name", "beams"), [("hdl64", 64), ("hdl32", 32), ("vlp16", 16), ("os1-64", 64)])
def test_a_sensor_returns_points_on_its_own_elevations_only(town: World, name: str, beams: int) -> None:
    sensor = dataclasses.replace(SENSORS[name], columns=180)
    scan = next(simulate(town, drive(STREET, town.ground, spacing_m=200.0), sensor, seed=0))
    assert sensor.beams == beams
    elevation = np.degrees(np.arcsin(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1)))
    np.testing.assert_allclose(elevation, np.array(sensor.elevations_deg)[scan.beam], atol=1e-3)
    assert len(np.unique(scan.beam)) > 0.8 * beams


def test_only_points_on_things_that_move_are_labelled_as_moving() -> None:
    # One car drives along x at y = 5 with 10 m/s: at 0 s its centre is at x = 5, at 1 s it is behind the wall.
    path = Path.through([[0.0, 5.0], [1000.0, 5.0]])
    one = np.zeros(1, np.int64)
    traffic = Traffic((path,), one, np.zeros(1), np.array([10.0]), np.array([5.0]), one)
    sensor = dataclasses.replace(OS1_64, dropout=0.0, columns=360)
    now, later = simulate(flat_world(traffic=traffic), standing_at((0.0, 0.0, 1.7), times_s=(0.0, 2.0)), sensor, seed=0)
    on_car = now.points[now.moving]
    assert len(on_car) > 50
    assert np.abs(on_car[:, 0] - 5.0).max() < 2.4 and np.abs(on_car[:, 1] - 5.0).max() < 1.2
    inside = (np.abs(now.points[:, 0] - 5.0) < 1.9) & (np.abs(now.points[:, 1] - 5.0) < 0.8) & (now.points[:, 2] > -1.5)
    assert now.moving[inside].all()
    assert not later.moving.any()


def test_a_parked_car_stays_while_in_sight_and_may_be_another_after_the_robot_was_away() -> None:
    slots = ParkingSlots(np.column_stack([np.arange(0, 60, 6.0), np.zeros((10, 2))]), np.zeros(10), 0.5, seed=3)
    parked = ParkedCars(slots)

    def seen(x: float) -> list[tuple[float, ...]]:
        return [tuple(car.base.ravel()) for car in parked.around(np.array([x, 0.0]))]

    first, still = seen(10.0), seen(15.0)
    assert first == still and 0 < len(first) < 10
    assert seen(1000.0) == []
    assert seen(10.0) != first


def test_nothing_solid_stands_in_the_way_of_the_drive(town: World) -> None:
    trajectory = drive(STREET, town.ground, spacing_m=5.0)
    for scan in simulate(town, trajectory, dataclasses.replace(VLP16, columns=360), seed=0):
        still = scan.points[~scan.moving]
        above_ground = still[still[:, 2] > -1.3]
        assert np.linalg.norm(above_ground[:, :2], axis=1).min() > 1.0


def test_a_lane_offset_moves_the_drive_to_the_right(town: World) -> None:
    left = drive(STREET, town.ground, sway_seed=None)
    right = drive(STREET, town.ground, lane_m=1.7, sway_seed=None)
    np.testing.assert_allclose(right.T_world_sensor[:, 1, 3] - left.T_world_sensor[:, 1, 3], -1.7, atol=1e-6)
    spacing = np.diff(right.T_world_sensor[:, 0, 3])
    np.testing.assert_allclose(spacing, 1.0, atol=1e-6)
    assert np.all(np.diff(right.stamps_ns) == 125_000_000)


def test_far_and_grazing_hits_are_reported_less_often() -> None:
    near, far = OS1_64.detection_probability(np.array([10.0, 80.0]), np.ones(2), np.full(2, Material.WALL, np.uint8))
    head_on, grazing = OS1_64.detection_probability(np.full(2, 50.0), np.array([1.0, 0.05]), np.zeros(2, np.uint8))
    assert near > 0.9 and near > far > 0.0
    assert head_on > 2 * grazing


def test_the_default_grid_drive_comes_back_in_both_directions_and_across() -> None:
    path = grid_drive(StreetGrid.random(4, 4, seed=0))
    arc = np.arange(0.0, path.length, 2.0)
    position, heading = path.at(arc), path.heading(arc)
    near = np.linalg.norm(position[:, None] - position[None], axis=2) < 3.0
    apart = np.abs(arc[:, None] - arc[None]) > 150.0
    turn = np.degrees(np.abs(np.angle(np.exp(1j * (heading[:, None] - heading[None])))))[near & apart]
    assert (turn < 10).any() and (turn > 170).any() and ((turn > 80) & (turn < 100)).any()


def test_streets_under_a_drive_are_not_doubled_where_it_repeats_itself() -> None:
    there_and_back = Path.through([[0.0, 0.0], [300.0, 0.0], [300.0, 3.0], [0.0, 3.0]])
    total = sum(street.length for street in streets_under(there_and_back))
    assert total == pytest.approx(300.0, abs=30.0)


def test_kitti_camera_poses_become_a_way_over_ground() -> None:
    # Camera z is ahead and camera x to the right: driving ahead and drifting right is +x and -y on the ground.
    poses = np.zeros((50, 3, 4))
    poses[:, 0, 3], poses[:, 2, 3] = np.linspace(0, 10, 50), np.linspace(0, 100, 50)
    path = kitti_path(poses.reshape(50, 12))
    np.testing.assert_allclose(path.points[-1], [100.0, -10.0], atol=1e-6)
