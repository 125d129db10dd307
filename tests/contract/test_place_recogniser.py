"""The contract of PlaceRecogniser: the method of core, and the fake that other tests use in its place."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, Profile
from revisit.core.errors import DataLoss
from revisit.core.geometry import se3
from revisit.core.place import Place
from revisit.core.scan import Scan
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.submap import Submap
from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.service.adapters.core_recogniser import CoreRecogniser, load_recogniser
from revisit.service.features.loops.claims import verdict_evidence
from tests.support.fake_recogniser import FakeRecogniser

CONFIG = PipelineConfig()
TILTED = se3.exp([3.0, -2.0, 0.5, 0.08, -0.05, 0.6])


def street(seed: int) -> np.ndarray:
    """Points (n, 3) of flat ground at z = -1.7 m and twelve walls, seen from the origin."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-40.0, 40.0, (12_000, 2)), rng.normal(-1.7, 0.02, 12_000)])
    walls = []
    for _ in range(12):
        centre, angle = rng.uniform(-35.0, 35.0, 2), rng.uniform(0.0, np.pi)
        along, height = rng.uniform(-6.0, 6.0, 1_200), rng.uniform(-1.7, 4.0, 1_200)
        walls.append(np.column_stack([centre[0] + along * np.cos(angle), centre[1] + along * np.sin(angle), height]))
    return np.concatenate([ground, *walls])


def seen_from(T_world_sensor: np.ndarray, seed: int) -> Submap:
    points = se3.apply(se3.inverse(T_world_sensor), street(seed)).astype(np.float32)
    return Submap.from_cloud(Scan.validated(points, T_world_sensor, 0))


@pytest.fixture(scope="module", params=["fake", "core"])
def recogniser(request):
    return FakeRecogniser() if request.param == "fake" else load_recogniser()


@pytest.fixture(scope="module")
def described(recogniser):
    return recogniser.describe(seen_from(TILTED, 1), CONFIG)


def test_a_description_is_complete(recogniser, described):
    assert recogniser.model_of(Profile.PRODUCT) != recogniser.model_of(Profile.PAPER)
    assert described.descriptor.dtype == np.float32 and described.descriptor.ndim == 1
    assert np.linalg.norm(described.descriptor) == pytest.approx(1.0, abs=1e-5)
    assert described.place and described.neural_map


def test_a_mesh_is_made_of_a_stored_neural_map(recogniser, described):
    mesh = recogniser.mesh(described.neural_map, CONFIG)
    assert len(mesh.normals) == len(mesh.vertices) > 0
    assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    with pytest.raises(DataLoss):
        recogniser.mesh(described.neural_map[5:], CONFIG)


def test_scans_behind_a_jump_are_noticed_and_sound_ones_are_not(recogniser):
    poses = [se3.from_yaw(0.1 * step, (2.5 * step, 0.0, 0.0)) for step in range(4)]
    seen = [se3.apply(se3.inverse(pose), street(1)).astype(np.float32) for pose in poses]
    scans = [Scan.validated(*pair, index * 10**8) for index, pair in enumerate(zip(seen, poses, strict=True))]
    assert recogniser.inspect(scans) == ()
    far = se3.from_yaw(0.0, (900.0, 0.0, 0.0))
    jumped = [replace(scan, T_odom_sensor=far @ scan.T_odom_sensor) for scan in scans[2:]]
    assert "pose_jump" in recogniser.inspect([*scans[:2], *jumped])


def test_the_same_submap_is_described_alike_again(recogniser, described):
    again = recogniser.describe(seen_from(TILTED, 1), CONFIG)
    np.testing.assert_array_equal(again.descriptor, described.descriptor)
    assert again.place == described.place


def test_a_stored_neural_map_is_enough_to_describe_a_submap_again(recogniser, described):
    again = recogniser.describe_again(described.neural_map, described.place, CONFIG)
    assert again.descriptor.shape == described.descriptor.shape
    assert np.linalg.norm(again.descriptor) == pytest.approx(1.0, abs=1e-5)
    assert isinstance(recogniser.verify(again.place, again.place, 1.0, CONFIG), VerifiedLoop)
    with pytest.raises(DataLoss):
        recogniser.describe_again(b"damaged" + described.neural_map, described.place, CONFIG)


def test_what_scans_disagree_on_outlives_a_new_description():
    method = CoreRecogniser()
    described = method.describe(seen_from(TILTED, 1), CONFIG)
    told = replace(Place.from_blob(described.place), scan_disagreement=ScanDisagreement(0.012, 0.004)).to_blob()

    def stated(place):
        again = method.describe_again(described.neural_map, place, CONFIG).place
        return Place.from_blob(again).scan_disagreement

    assert stated(told) == ScanDisagreement(0.012, 0.004)
    assert stated(None) is None and stated(told[:-5]) is None


def test_a_place_matches_itself_and_the_evidence_is_json(recogniser, described):
    verdict = recogniser.verify(described.place, described.place, 1.0, CONFIG)
    assert isinstance(verdict, VerifiedLoop) and 0.9 < verdict.measurement.score <= 1.0 + 1e-6
    evidence = verdict_evidence(verdict, CONFIG.verification)
    assert json.loads(json.dumps(evidence, allow_nan=False)) == evidence


def test_what_was_let_go_of_is_made_again_with_the_same_verdict(recogniser, described):
    other = recogniser.describe(seen_from(np.eye(4), 1), CONFIG).place
    before = recogniser.verify(described.place, other, 0.9, CONFIG)
    recogniser.release()
    after = recogniser.verify(described.place, other, 0.9, CONFIG)
    assert type(after) is type(before)
    told = [verdict_evidence(one, CONFIG.verification) for one in (before, after)]
    assert told[0] == told[1]


def test_the_verdict_names_its_rules_and_tells_other_rules_apart():
    method = load_recogniser()
    place = method.describe(seen_from(np.eye(4), 1), CONFIG).place

    def judged(**rules):
        config = replace(CONFIG, verification=replace(CONFIG.verification, **rules))
        return verdict_evidence(method.verify(place, place, 1.0, config), config.verification)

    usual, strict = judged(), judged(min_overlap=1.0, max_tilt=14.0)
    rules = CONFIG.verification
    told = {"min_score": rules.min_score, "min_overlap": rules.min_overlap, "max_seen_through": rules.max_seen_through}
    assert usual["thresholds"] == told
    assert strict["thresholds"] == {**told, "min_overlap": 1.0, "max_tilt": 14.0}
    assert usual["thresholds_version"] != strict["thresholds_version"]
    assert len(json.dumps(usual)) < 1500


def test_another_place_is_rejected_with_a_reason(recogniser, described):
    other = recogniser.describe(seen_from(np.eye(4), 2), CONFIG)
    verdict = recogniser.verify(described.place, other.place, 0.1, CONFIG)
    assert isinstance(verdict, RejectedLoop) and verdict.reason
    json.dumps(verdict_evidence(verdict, CONFIG.verification), allow_nan=False)


def test_the_mesh_of_the_method_lies_in_the_frame_of_the_submap():
    own = load_recogniser()
    mesh = own.mesh(own.describe(seen_from(TILTED, 1), CONFIG).neural_map, CONFIG)
    height = se3.apply(TILTED, mesh.vertices)[:, 2]
    ground = np.abs(height + 1.7) < 0.3
    # Most of the street is ground at -1.7 m of the world. In the levelled frame, taken for the submap's, the sensor's
    # tilt of 5 degrees would leave a tenth of the vertices there.
    assert ground.mean() > 0.7
    up = (mesh.normals[ground] @ TILTED[:3, :3].T).mean(axis=0)
    assert up[2] / np.linalg.norm(up) > 0.99


def test_a_damaged_place_is_data_loss(described):
    recogniser = load_recogniser()
    with pytest.raises(DataLoss):
        recogniser.verify(described.place[:-5], described.place, 1.0, CONFIG)
