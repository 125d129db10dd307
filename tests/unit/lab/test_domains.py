"""Worlds built differently: deterministic, driven as said, with scatter like real vegetation; results that go on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as Folder

import numpy as np
import pytest
from typer.testing import CliRunner

from lab.command_line import app_of
from lab.domains.__main__ import domains
from lab.domains.catalogue import DOMAINS, Domain, Pass, Setting, SomeScans
from lab.domains.evaluation import evaluate_domain
from lab.domains.report import write_domains
from lab.realism import scan_statistics
from lab.recognition.remembered_verdicts import RememberedVerdicts
from lab.worlds.drives import DrivenWorld, Leg, Ride, backwards, winding_way
from lab.worlds.open_world import OpenWorld
from lab.worlds.relief import NearestHeights, Waves
from lab.worlds.resimulation import beside_where_free
from lab.worlds.verge import CANYON, MIXED, WOODS, Style, grow
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.submap import Submap
from revisit.evaluation import real_data
from revisit.evaluation.loop_closure_method import Description, Verdict
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.simulator import HDL32, VLP16, Path
from revisit.evaluation.simulator.blocks import Material, block
from tests.support.real_data import needs_real_data

SENSOR = replace(VLP16, columns=200)
WAY = winding_way(90.0, 3)
LEGS = (Leg(WAY, 1.5), Leg(backwards(WAY), 1.5))


@pytest.fixture(scope="module")
def world() -> OpenWorld:
    return grow(WAY, MIXED, 3)


def driven(world: OpenWorld, seed: int = 3) -> DrivenWorld:
    return DrivenWorld("small", world, LEGS, Ride(SENSOR, spacing_m=3.0, seed=seed))


def test_the_same_seed_grows_the_same_world_and_casts_the_same_scans(world: OpenWorld) -> None:
    again = grow(WAY, MIXED, 3)
    np.testing.assert_array_equal(world.triangles, again.triangles)
    np.testing.assert_array_equal(driven(world).scan(4).points, driven(again).scan(4).points)
    np.testing.assert_array_equal(driven(world).pose(4), driven(again).pose(4))
    other = grow(WAY, MIXED, 4)
    assert other.triangles.shape != world.triangles.shape or not np.array_equal(other.triangles, world.triangles)


def test_the_way_back_is_another_pass_over_the_same_ground(world: OpenWorld) -> None:
    recording = driven(world)
    truth = recording.trajectory.T_world_sensor
    back = np.flatnonzero(recording.stamps_ns > 3_000 * 10**9)
    out, first = truth[: back[0]], truth[back[len(back) // 2]]
    nearest = int(np.linalg.norm(out[:, :3, 3] - first[:3, 3], axis=1).argmin())
    assert np.linalg.norm((out[nearest] - first)[:2, 3]) == pytest.approx(3.0, abs=1.7)  # the other lane
    assert float(np.degrees(se3.rotation_angle(se3.inverse(out[nearest]) @ first))) > 150.0
    assert not np.array_equal(world.parked(3_000).base, world.parked(3_001).base)


def test_a_recorded_pose_is_the_true_one_within_the_noise_of_a_good_odometry(world: OpenWorld) -> None:
    recording = driven(world)
    errors = [
        se3.inverse(recording.trajectory.T_world_sensor[index]) @ recording.pose(index)
        for index in range(len(recording))
    ]
    shifts = np.array([error[:3, 3] for error in errors])
    assert 0.004 < shifts.std() < 0.02
    assert max(float(np.degrees(se3.rotation_angle(error))) for error in errors) < 0.5


def test_what_is_seen_lies_on_the_surfaces_of_the_world(world: OpenWorld) -> None:
    """Truth is right: under their recorded poses all points lie on something."""
    import open3d as o3d

    recording = driven(world)
    triangles = np.concatenate([world.triangles, world.parked(3_000).triangles()])
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners = o3d.core.Tensor.from_numpy(triangles.reshape(-1, 3))
    scene.add_triangles(
        corners, o3d.core.Tensor.from_numpy(np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3))
    )
    for index in (0, 7):
        points = se3.apply(recording.pose(index), recording.scan(index).points).astype(np.float32)
        distance = scene.compute_distance(o3d.core.Tensor.from_numpy(points), nthreads=1).numpy()
        assert np.percentile(distance, 95) < 0.1


@pytest.mark.parametrize(("style", "share"), [(MIXED, (18.0, 55.0)), (WOODS, (18.0, 55.0)), (CANYON, (0.0, 25.0))])
def test_leaves_scatter_as_real_vegetation_does(style: Style, share: tuple[float, float]) -> None:
    """A real street (KITTI 00) has 35 % scatter, the towns of the simulator 9 %; a canyon has hardly any plants."""
    way = winding_way(120.0, 5)
    ride = Ride(replace(HDL32, columns=900), spacing_m=25.0, seed=5)
    recording = DrivenWorld("street", grow(way, style, 5), (Leg(way),), ride)
    rng = np.random.default_rng(0)
    scatter = [scan_statistics(scan, rng)["scatter"] for scan in recording]
    assert share[0] < np.mean(scatter) < share[1]


def test_nothing_stands_in_the_way(world: OpenWorld) -> None:
    for scan in driven(world):
        above_ground = scan.points[scan.points[:, 2] > -1.0]
        assert np.linalg.norm(above_ground[:, :2], axis=1).min() > 0.8


def test_a_path_beside_the_driven_one_gives_way_to_what_stands_there() -> None:
    ground = block((0, 0, -1), (200, 200, 1), Material.GROUND)
    car = block((30.0, 2.4, 0.0), (4.5, 1.8, 2.5), Material.METAL)
    triangles = np.concatenate([ground.triangles(), car.triangles()])
    materials = np.concatenate([ground.triangle_materials(), car.triangle_materials()])
    flat = OpenWorld(triangles, materials, NearestHeights(np.array([[0.0, 0, 0], [60, 0, 0], [0, 60, 0]])))
    way = Path.through([[0.0, 0.0], [60.0, 0.0]])
    beside = beside_where_free(flat, way, 2.2, 1.8)
    at_car = np.abs(beside.points[:, 0] - 30.0) < 2.0
    assert beside.points[at_car, 1].max() < 0.5
    assert beside.points[np.abs(beside.points[:, 0] - 10.0) < 2.0, 1].min() > 2.0


def test_a_sensor_inside_of_something_sees_an_empty_cloud() -> None:
    box = block((0, 0, -5), (1.0, 1.0, 10.0), Material.METAL)
    inside = OpenWorld(box.triangles(), box.triangle_materials(), Waves(np.zeros(1), np.zeros((1, 2)), np.zeros(1)))
    way = Path.through([[0.0, 0.0], [0.2, 0.0]])
    recording = DrivenWorld("inside", inside, (Leg(way),), Ride(SENSOR, spacing_m=1.0, pose_noise_m=0.0))
    with pytest.raises(EmptyCloud):
        recording.scan(0)


class Ranges:
    """Stands for the product: a histogram of ranges; a loop is accepted where two histograms are equal."""

    def __init__(self) -> None:
        self.verified = 0

    def __repr__(self) -> str:
        return "Ranges()"

    def describe(self, submap: Submap, seed: int) -> Description:
        counts = np.histogram(np.linalg.norm(submap.points, axis=1), np.arange(0.0, 60.0, 2.0))[0].astype(np.float32)
        vector = counts / np.linalg.norm(counts)
        return Description(vector, vector.tobytes())

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        self.verified += 1
        return Verdict(0.5, None, np.eye(4)) if query == match else Verdict(0.1, "LOW_OVERLAP", None)


def test_a_verdict_is_asked_for_once_however_often_a_pair_is_proposed() -> None:
    method = Ranges()
    remembered = RememberedVerdicts(method)
    assert [remembered.verify(b"a", b"a", s).accepted for s in (0.9, 0.2)] == [True, True]
    assert not remembered.verify(b"a", b"b", 0.9).accepted
    assert method.verified == 2


@pytest.fixture
def small(world: OpenWorld) -> Domain:
    return Domain("small", "a test", lambda _: Pass(driven(world)), loops=LoopProtocol(min_index_gap=3))


def test_a_domain_is_evaluated_with_peers_verified_like_the_product_and_goes_on_from_its_file(
    small: Domain, tmp_path: Folder
) -> None:
    method = Ranges()
    experiment = evaluate_domain(small, tmp_path, lambda *_: None, candidates=2, method=method)
    names = [result.method for result in experiment.results]
    assert names[:2] == ["revisit descriptor", "revisit verified"]
    assert {"ring", "ring + our verification", "ring++ + our verification", "scan-context + our verification"} < set(
        names
    )
    asked = method.verified
    again = evaluate_domain(small, tmp_path, lambda *_: None, candidates=2, method=method)
    assert again == experiment and method.verified == asked > 0
    with np.load(tmp_path / "small-vectors.npz") as kept:
        assert len(kept["vectors"]) == len(kept["positions"]) == len(experiment.query_positions)
    text = write_domains([experiment], [], tmp_path)[0].read_text()
    assert "| small |" in text and "ring + our verification" in text


def test_domains_of_real_data_say_why_they_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(real_data.VARIABLE, raising=False)
    missing = {domain.name for domain in DOMAINS if domain.missing}
    assert {"facades", "resimulated", "real-halves"} <= missing
    assert {"country-road", "canyon", "woods"}.isdisjoint(missing)


def test_the_command_leaves_out_what_it_cannot_run_and_refuses_unknown_names(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Folder
) -> None:
    monkeypatch.delenv(real_data.VARIABLE, raising=False)
    app = app_of(domains)
    run = CliRunner().invoke(app, ["--only", "facades", "--out", str(tmp_path)])
    assert run.exit_code == 0, run.output
    assert "facades was left out" in run.output and "Not run: facades" in (tmp_path / "domains.md").read_text()
    assert CliRunner().invoke(app, ["--only", "atlantis"]).exit_code != 0


def test_every_second_scan_keeps_its_pose_and_time(world: OpenWorld) -> None:
    whole = driven(world)
    odd = SomeScans("odd", whole, 1)
    assert len(odd) == len(whole) // 2 and odd.stamps_ns[0] == whole.stamps_ns[1]
    np.testing.assert_array_equal(odd.pose(2), whole.pose(5))


@pytest.mark.real_data
@needs_real_data
def test_the_street_between_real_facades_is_free_to_drive(tmp_path: Folder) -> None:
    facades = next(domain for domain in DOMAINS if domain.name == "facades")
    recording = facades.make(Setting(tmp_path)).queries
    for index in range(0, len(recording), 40):
        points = recording.scan(index).points
        assert len(points) > 3_000
        assert np.linalg.norm(points[points[:, 2] > -1.0][:, :2], axis=1).min() > 0.5
