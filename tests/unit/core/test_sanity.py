"""Mistakes that are easily made with clouds and poses: each is found, and a sound drive has no findings."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import OutOfRange
from revisit.core.geometry import se3
from revisit.core.sanity.finding import LIKELY_CAUSES
from revisit.core.sanity.ground import ground_plane, place_flags
from revisit.core.sanity.window import window_findings
from revisit.core.scan import Scan
from revisit.evaluation.datasets.kitti import read_velodyne
from revisit.evaluation.inspection import inspect_recording

START_NS = 1_700_000_000 * 10**9
CAMERA_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class Drive:
    """A recording in memory."""

    clouds: list[np.ndarray]
    poses: list[np.ndarray]
    stamps_ns: np.ndarray
    name: str = "drive"

    def __len__(self) -> int:
        return len(self.clouds)

    def pose(self, index: int) -> np.ndarray:
        return self.poses[index]

    def scan(self, index: int) -> Scan:
        return Scan.validated(self.clouds[index], self.poses[index], int(self.stamps_ns[index]))

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))


def street(random: np.random.Generator) -> np.ndarray:
    """A ground of 120 m with houses, whose walls stand on no regular grid."""
    ground = np.column_stack([random.uniform(-60, 60, (30_000, 2)), random.normal(0, 0.01, 30_000)])
    parts = [ground]
    for _ in range(40):
        centre, size, height = random.uniform(-55, 55, 2), random.uniform(2, 8, 2), random.uniform(2, 9)
        if np.hypot(*(centre - np.clip(centre, -1e9, 1e9))) == 0.0 and abs(np.hypot(*centre) - 25) < 7:
            continue
        side, along = random.integers(0, 4, 1500), random.uniform(-1, 1, 1500)
        walls = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])[side]
        plan = centre + size * (walls + along[:, None] * np.abs(walls[:, ::-1]))
        parts.append(np.column_stack([plan, random.uniform(0, height, 1500)]))
    return np.concatenate(parts)


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Thirty scans on a circle of 25 m, 1.7 m over the ground, a metre apart."""
    random = np.random.default_rng(11)
    world = street(random)
    angles = 0.3 + np.arange(30) / 25.0
    poses = [se3.from_yaw(a + np.pi / 2, (25 * np.cos(a), 25 * np.sin(a), 1.7)) for a in angles]
    clouds = []
    for pose in poses:
        near = world[np.linalg.norm(world[:, :2] - pose[:2, 3], axis=1) < 30.0]
        some = near[random.random(len(near)) < 0.7]
        clouds.append((se3.apply(se3.inverse(pose), some) + random.normal(0, 0.01, some.shape)).astype(np.float32))
    return Drive(clouds, poses, START_NS + np.arange(30) * 100_000_000)


def read_as(cloud: np.ndarray, columns: int, folder: Path) -> np.ndarray:
    """What reading rows of four makes of a file with another number of columns."""
    rows = np.zeros((len(cloud), columns), dtype="<f4")
    rows[:, :3] = cloud
    rows[:, 3:] = np.random.default_rng(0).uniform(0, 60, (len(cloud), columns - 3))
    flat = rows.ravel()
    flat[: len(flat) // 4 * 4].tofile(folder / "scan.bin")
    return read_velodyne(folder / "scan.bin").points


def reordered(pose: np.ndarray) -> np.ndarray:
    """A pose whose quaternion was written w, x, y, z and is read as x, y, z, w."""
    x, y, z, w = se3.to_quaternion(pose)
    return se3.from_quaternion((w, x, y, z), pose[:3, 3])


def clouds(change) -> object:
    return lambda drive, folder: replace(drive, clouds=[change(cloud, folder) for cloud in drive.clouds])


def poses(change) -> object:
    return lambda drive, folder: replace(drive, poses=[change(pose) for pose in drive.poses])


def half_missing(cloud: np.ndarray, folder: Path) -> np.ndarray:
    thinned = cloud.copy()
    thinned[::2] = np.nan
    return thinned


def with_jumps(drive: Drive, folder: Path) -> Drive:
    moved = [pose.copy() for pose in drive.poses]
    for pose in moved[15:]:
        pose[0, 3] += 5_000.0
    return replace(drive, poses=moved)


def in_camera_axes(drive: Drive, folder: Path) -> Drive:
    """Clouds and poses alike, as a depth camera gives them."""
    turned = [se3.apply(CAMERA_LIDAR, cloud).astype(np.float32) for cloud in drive.clouds]
    moved = [CAMERA_LIDAR @ pose @ np.linalg.inv(CAMERA_LIDAR) for pose in drive.poses]
    return replace(drive, clouds=turned, poses=moved)


def registered(drive: Drive, folder: Path) -> Drive:
    moved = [se3.apply(pose, cloud) for pose, cloud in zip(drive.poses, drive.clouds, strict=True)]
    return replace(drive, clouds=[cloud.astype(np.float32) for cloud in moved])


def upside_down(drive: Drive, folder: Path) -> Drive:
    down = np.diag([1.0, -1, -1, 1])
    return replace(drive, poses=[down @ pose for pose in drive.poses])


MISTAKES = {
    "centimetres": (clouds(lambda cloud, _: cloud * 100), "scene_too_large", "centimetres"),
    "millimetres": (clouds(lambda cloud, _: cloud * 1000), "scene_too_large", "millimetres"),
    "kilometres": (clouds(lambda cloud, _: cloud / 1000), "scene_too_small", "kilometres"),
    "rows of three": (clouds(lambda cloud, folder: read_as(cloud, 3, folder)), "columns", "rows of 3"),
    "rows of five": (clouds(lambda cloud, folder: read_as(cloud, 5, folder)), "columns", "rows of 5"),
    "half missing": (clouds(half_missing), "non_finite", "organised"),
    "zeros": (clouds(lambda cloud, _: cloud * (np.arange(len(cloud)) % 2)[:, None]), "zeros", "did not come back"),
    "thinned": (clouds(lambda cloud, _: cloud[::40]), "sparse", "thinned"),
    "y mirrored": (clouds(lambda cloud, _: cloud * np.float32([1, -1, 1])), "mirrored", "y axis"),
    "x mirrored": (clouds(lambda cloud, _: cloud * np.float32([-1, 1, 1])), "mirrored", "axis is mirrored"),
    "w first": (poses(reordered), "quaternion_order", "w, x, y, z"),
    "inverted": (poses(se3.inverse), "poses_inverted", "inverted"),
    "poses of a camera": (
        poses(lambda pose: CAMERA_LIDAR @ pose @ np.linalg.inv(CAMERA_LIDAR)), "camera_axes", "camera"
    ),
    "camera axes": (in_camera_axes, "ground_tilted", "camera axes"),
    "z down": (upside_down, "ground_tilted", "z points down"),
    "registered": (registered, "registered", "already in the frame"),
    "jumps of 5 km": (with_jumps, "pose_jump", "GNSS"),
    "seconds": (lambda drive, _: replace(drive, stamps_ns=drive.stamps_ns // 10**9), "time_unit", "seconds"),
    "milliseconds": (lambda drive, _: replace(drive, stamps_ns=drive.stamps_ns // 10**6), "time_unit", "milliseconds"),
    "microseconds": (lambda drive, _: replace(drive, stamps_ns=drive.stamps_ns // 10**3), "time_unit", "microseconds"),
    "a clock set back": (
        lambda drive, _: replace(drive, stamps_ns=np.roll(drive.stamps_ns, 7)), "time_goes_back", "clock"
    ),
    "scans sent twice": (
        lambda drive, _: replace(drive, stamps_ns=10**18 + np.arange(len(drive.stamps_ns)) // 2 * 10**8),
        "time_goes_back", "there twice",
    ),
    "poses in centimetres": (
        poses(lambda pose: se3.from_rotation_translation(pose[:3, :3], 100 * pose[:3, 3])), "too_fast", "no metres"
    ),
}  # fmt: skip


def test_a_sound_drive_has_no_findings(drive: Drive) -> None:
    inspection = inspect_recording(drive)
    assert inspection.findings == ()
    assert inspection.figures["height_over_ground_m"] == pytest.approx(1.7, abs=0.1)
    assert inspection.figures["travelled_m"] == pytest.approx(29.0, abs=0.1)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_found_with_its_cause(drive: Drive, tmp_path: Path, name: str) -> None:
    make, code, cause = MISTAKES[name]
    findings = {finding.code: finding for finding in inspect_recording(make(drive, tmp_path)).findings}
    assert code in findings, findings
    assert cause in findings[code].cause


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_found_in_the_scans_of_one_submap(drive: Drive, tmp_path: Path, name: str) -> None:
    make, code, _ = MISTAKES[name]
    made = make(drive, tmp_path)
    scans = []
    for index in range(len(made)):
        try:
            scans.append(made.scan(index))
        except OutOfRange:
            assert name == "millimetres"
            return
    assert code in {finding.code for finding in window_findings(scans)}


def test_the_scans_of_a_sound_submap_have_no_findings(drive: Drive) -> None:
    assert window_findings(list(drive)) == []
    assert window_findings(list(drive)[:1]) == []


def test_what_is_found_is_explained_where_nothing_else_is_at_hand() -> None:
    codes = {code for _, code, _ in MISTAKES.values()}
    assert codes | {"degenerate_plane", "empty_cloud", "odometry_bends"} == LIKELY_CAUSES.keys()


def test_returns_that_did_not_come_back_hide_nothing_else_and_add_nothing(drive: Drive, tmp_path: Path) -> None:
    findings = inspect_recording(MISTAKES["zeros"][0](drive, tmp_path)).findings
    assert [finding.code for finding in findings] == ["zeros"]


def test_a_slope_and_a_tilted_sensor_are_no_mistakes(drive: Drive) -> None:
    tilted = se3.exp([0, 0, 0, 0.0, 0.4, 0.0])
    sensor = replace(
        drive,
        clouds=[se3.apply(se3.inverse(tilted), cloud).astype(np.float32) for cloud in drive.clouds],
        poses=[pose @ tilted for pose in drive.poses],
    )
    assert inspect_recording(sensor).findings == ()
    slope = se3.exp([0, 0, 0, 0.15, 0.0, 0.0])
    assert inspect_recording(replace(drive, poses=[slope @ pose for pose in drive.poses])).findings == ()


@pytest.mark.parametrize("degrees", [11.0, 17.0, 25.0])
def test_an_odometry_whose_z_leans_is_told(drive: Drive, degrees: float) -> None:
    """Of 17 degrees no pair with an upright session is a loop, and the plane under a sensor counts as level."""
    lean = se3.exp([0, 0, 0, np.radians(degrees), 0.0, 0.0])
    leaning = replace(drive, poses=[lean @ pose for pose in drive.poses])
    (finding,) = window_findings(list(leaning))
    assert finding.code == "ground_tilted"
    (told,) = [int(word) for word in finding.measured.split() if word.isdigit()]
    assert told == pytest.approx(degrees, abs=1.0)


def test_a_submap_is_flagged_where_its_ground_is_tilted_or_its_scene_too_small(drive: Drive) -> None:
    cloud = drive.clouds[0]
    assert place_flags(cloud) == ()
    assert place_flags(se3.apply(CAMERA_LIDAR, cloud)) == ("ground_tilted",)
    assert place_flags(cloud / 100) == ("scene_too_small",)
    # The points of a map of rooms come divided by its scale: 30 of them are 1.2 m here, and 0.3 m there.
    assert place_flags(cloud, 0.04) == ()
    assert place_flags(cloud, 0.01) == ("scene_too_small",)


def test_a_wall_beside_a_sensor_that_sees_no_ground_is_not_taken_for_one() -> None:
    random = np.random.default_rng(4)
    wall = np.column_stack([random.uniform(1, 20, 5000), np.full(5000, 4.0), random.uniform(0, 6, 5000)])
    assert ground_plane(wall + random.normal(0, 0.01, wall.shape)) is None


def test_the_ground_is_found_without_a_compiler_as_with_one(monkeypatch):
    rng = np.random.default_rng(3)
    floor = np.column_stack([rng.uniform(-20, 20, (4000, 2)), rng.normal(-1.7, 0.02, 4000)])
    wall = np.column_stack([np.full(1500, 9.0), rng.uniform(-9, 9, 1500), rng.uniform(-1.7, 4, 1500)])
    compiled = ground_plane(np.vstack([floor, wall]))
    monkeypatch.setitem(sys.modules, "revisit.core.kernels.plane_votes", None)
    plain = ground_plane(np.vstack([floor, wall]))
    np.testing.assert_allclose(plain.normal, compiled.normal)
    assert (plain.height_m, plain.upright) == (pytest.approx(compiled.height_m), compiled.upright)


def rings_and_poles(pose: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """What a sensor of few beams sees of a level ground with a pole every 9 m, in its frame."""
    radii = 1.7 / np.tan(np.radians([7.0, 9.0, 11.0, 13.0, 15.0, 17.0, 20.0]))
    turns = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    rings = [np.column_stack([r * np.cos(turns), r * np.sin(turns), np.full(360, -1.7)]) for r in radii]
    feet = np.stack(np.meshgrid(np.arange(-27.0, 60.0, 9.0), [-6.0, 7.0]), axis=-1).reshape(-1, 2)
    poles = np.column_stack([np.repeat(feet, 40, axis=0), np.tile(np.linspace(0, 4, 40), len(feet))])
    seen = np.concatenate([*rings, se3.apply(se3.inverse(pose), poles)])
    return (seen + random.normal(0, 0.01, seen.shape)).astype(np.float32)


def test_rings_on_a_level_ground_that_go_with_the_sensor_are_no_clouds_in_the_frame_of_the_odometry() -> None:
    random = np.random.default_rng(2)
    moved = [se3.from_yaw(0.0, (1.3 * step, 0.0, 1.7)) for step in range(12)]
    sound = [Scan.validated(rings_and_poles(pose, random), pose, START_NS + 10**8 * k) for k, pose in enumerate(moved)]
    assert window_findings(sound) == []
    wrong = [replace(scan, points=se3.apply(scan.T_odom_sensor, scan.points).astype(np.float32)) for scan in sound]
    assert "registered" in {finding.code for finding in window_findings(wrong)}
