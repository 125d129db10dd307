"""BoW3D and its LinK3D features on scans of posts, whose lines and poses are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from lab.baselines.bow3d import Bow3d, words_of
from lab.baselines.link3d import Edges, Link3d, LinkFeatures, descriptors
from lab.baselines.scan_lines import ScanLines, roughness, scan_lines
from lab.recognition.experiment import Experiment
from lab.recognition.scan_baseline import SEVERAL_NAME, with_bow3d
from revisit.core.geometry import se3
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.metrics import LoopProtocol

BEAMS_DEG = tuple(np.linspace(-15.0, 15.0, 16).tolist())
SHOTS, POST_M, POSTS, REACH_M = 1800, 0.3, 40, 60.0


def scan(seed: int, T_world_sensor: se3.Matrix4) -> np.ndarray:
    """What 16 beams see of tall posts at random and nothing else."""
    feet = np.random.default_rng(seed).uniform(-50, 50, (POSTS, 2))
    middle = se3.apply(se3.inverse(T_world_sensor), np.column_stack([feet, np.zeros(POSTS)]))[:, :2]
    azimuth = 2 * np.pi * np.arange(SHOTS) / SHOTS
    ahead = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    along, beside = ahead @ middle.T, ahead @ (middle[:, ::-1] * [1, -1]).T
    chord = np.sqrt(np.maximum(POST_M**2 - beside**2, 0.0))
    ranges = np.where((np.abs(beside) < POST_M) & (along > 1.0), along - chord, np.inf).min(axis=1)
    hit = ranges < REACH_M
    plan = ahead[hit] * ranges[hit, None]
    rise = np.tan(np.radians(BEAMS_DEG))
    return np.concatenate([np.column_stack([plan, slope * ranges[hit]]) for slope in rise]).astype(np.float32)


def features(seed: int, T_world_sensor: se3.Matrix4) -> LinkFeatures:
    return Link3d().features(scan(seed, T_world_sensor), BEAMS_DEG)


HERE = np.eye(4)
NO_EDGES = Edges(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0, dtype=np.int64))


def test_a_return_belongs_to_the_nearest_beam_or_to_none_and_lines_run_with_the_azimuth() -> None:
    points = np.array([[0, 10, 1], [10, 0, 1], [10, 0, -1], [10, 0, 0], [0, 0, 5]], dtype=np.float32)
    lines = scan_lines(points, (5.7, -5.7))
    np.testing.assert_array_equal(lines.line, [0, 1, 1])
    np.testing.assert_allclose(lines.points, points[[2, 1, 0]])


def test_a_return_is_as_rough_as_it_stands_out_from_its_neighbours() -> None:
    # Eleven returns with five neighbours to each side: every window is the whole ring, whose mean is (1, 0, 0).
    ring = np.zeros((11, 3))
    ring[3, 0] = 11.0
    one_line = ScanLines(ring, np.zeros(11, dtype=np.int64))
    expected = np.full(11, 11.0**2)
    expected[3] = 110.0**2
    np.testing.assert_allclose(roughness(one_line, 5), expected)
    assert not roughness(ScanLines(ring[:10], np.zeros(10, dtype=np.int64)), 5).any()


def test_a_descriptor_holds_the_nearest_key_point_of_each_sector_from_the_nearest_one_on() -> None:
    # Ahead 1 m, left 2 m, behind 3 m: 90 degrees are sector 45. The second direction (left) fills sector 135.
    found = descriptors(np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [-3, 0, 0]]))
    assert {sector: int(found[0, sector]) for sector in np.flatnonzero(found[0])} == {0: 10, 45: 20, 90: 30, 135: 10}


def test_key_points_stand_on_posts_and_a_turned_scan_has_the_same_words() -> None:
    here, turned = features(0, HERE), features(0, se3.from_yaw(np.pi / 2))
    feet = np.random.default_rng(0).uniform(-50, 50, (POSTS, 2))
    away = np.linalg.norm(here.points[:, None, :2] - feet[None], axis=2).min(axis=1)
    assert len(here.points) > 20 and np.mean(away < 0.7) > 0.9
    same, other = words_of(here, 5), words_of(features(1, HERE), 5)
    again = words_of(turned, 5)
    assert np.mean((same == again)[same > 0]) > 0.9 > 0.1 > np.mean((same == other)[same > 0])


def test_the_scan_of_the_same_place_has_most_votes_and_its_pose_is_found() -> None:
    T_world_query = se3.from_yaw(0.5, (1.5, 1.0, 0.0))
    query, method = features(3, T_world_query), Bow3d()
    places = [features(seed, HERE) for seed in range(6)]
    votes = method.votes(query, method.words(places))
    agreeing = [method.agreeing(query, place)[0] for place in places]
    assert max(votes, key=lambda place: votes[place]) == 3 == int(np.argmax(agreeing))
    np.testing.assert_allclose(method.agreeing(query, places[3])[1], T_world_query, atol=0.15)
    assert dataclasses.replace(method, reach_m=0.5).agreeing(query, places[3])[0] < agreeing[3] / 2


def test_words_that_stand_in_far_more_places_than_others_do_not_vote() -> None:
    def single(*sectors: int) -> LinkFeatures:
        row = np.zeros((1, 180), dtype=np.int16)
        row[0, list(sectors)] = 7
        return LinkFeatures(np.zeros((1, 3)), row, NO_EDGES)

    # Word 0 stands in all eight places, each other one in a single place: 16 words of 9 kinds.
    method = Bow3d()
    known = method.words([single(0, 1 + place) for place in range(8)])
    assert known.places_a_word == pytest.approx(16 / 9)
    assert method.votes(single(0, 4), known) == {3: 1}
    assert dataclasses.replace(method, frequent=8.0).votes(single(0, 4), known)[3] == 2
    assert method.votes(single(4), known.of(np.arange(8) != 3)) == {}


def drive(folder: Path) -> tuple[KittiRecording, Experiment]:
    """Two scans at each of four places, then of the first two again, 1 m aside; the second place's scans are lost."""
    poses = [se3.from_yaw(0.2 * n, (0.5 * (n % 2) + (n >= 8), 0.0, 0.0)) for n in range(12)]
    clouds = [scan(number // 2 % 4, pose)[: 0 if number in (2, 3) else None] for number, pose in enumerate(poses)]
    write_kitti(folder, [(*seen, number * 10**8) for number, seen in enumerate(zip(clouds, poses, strict=True))])
    positions = tuple((40.0 * (place % 4), 0.0, 0.0) for place in range(6))
    windows = tuple((2 * place, 2 * place + 1) for place in range(6))
    loops = LoopProtocol(positive_radius_m=10.0, min_index_gap=2)
    return KittiRecording(folder), Experiment(
        "drive", "online", "drive", "drive", loops, positions, positions, windows, windows, True, (), {}
    )


def test_submaps_are_found_again_by_their_scans_and_a_lost_scan_keeps_its_number(tmp_path: Path) -> None:
    recording, experiment = drive(tmp_path)
    asked = []

    def verification(matches, name):
        asked.append(name)
        return dataclasses.replace(answered_before, method=name)

    answered_before = with_bow3d(experiment, recording, BEAMS_DEG).result("bow3d")
    answered = with_bow3d(experiment, recording, BEAMS_DEG, verification)
    for name in ("bow3d", SEVERAL_NAME):
        first = answered.result(name).candidates
        assert first[:3] == ((), (), ()) and first[4][0] == 0 and 1 not in first[5]
        assert answered.result(name).score[4] > 0.9
    assert asked == ["bow3d + our verification", f"{SEVERAL_NAME} + our verification"]


def test_an_experiment_between_two_recordings_is_refused(tmp_path: Path) -> None:
    recording, experiment = drive(tmp_path)
    with pytest.raises(ValueError, match="one drive"):
        with_bow3d(dataclasses.replace(experiment, within_session=False), recording, BEAMS_DEG)
