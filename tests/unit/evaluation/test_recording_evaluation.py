"""The evaluation of a recording by a method whose results are known: its descriptor is the direction to the place."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from lab.interleaved import evaluate_interleaved
from revisit.core.errors import DegenerateCloud
from revisit.core.geometry import se3
from revisit.core.submap import Submap
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.loop_closure_method import Description, Verdict
from revisit.evaluation.perturbations import Perturbation, keep_beams
from revisit.evaluation.recording_evaluation import EvaluationOptions, evaluate

RADIUS_M = 40.0
LAPS = 2
SCANS_PER_LAP = 100


@dataclass(frozen=True)
class Compass:
    """Knows where it is on the circle: near marks light up in the vector. Accepts what is within 26 degrees."""

    refuses_below_x: float = -1e9

    def describe(self, submap: Submap, seed: int) -> Description:
        centre = submap.T_odom_submap[:2, 3]
        if centre[0] < self.refuses_below_x:
            raise DegenerateCloud
        marks = np.arange(0.0, 2 * np.pi, 2 * np.pi / 120)
        vector = np.exp(100.0 * (np.cos(np.arctan2(centre[1], centre[0]) - marks) - 1.0)).astype(np.float32)
        return Description(vector, submap.T_odom_submap.tobytes(), neural_map_bytes=100, seconds={"look": 0.5})

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        T_world_query, T_world_match = (np.frombuffer(blob).reshape(4, 4) for blob in (query, match))
        likeness = float(T_world_query[:2, 3] @ T_world_match[:2, 3]) / RADIUS_M**2
        reason = None if likeness > 0.9 else "FAR"
        return Verdict(max(likeness, 0.0), reason, se3.inverse(T_world_match) @ T_world_query)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> KittiRecording:
    """Two laps on a circle of 40 m radius, a scan every 2.5 m."""
    rng, scans = np.random.default_rng(0), []
    for index in range(LAPS * SCANS_PER_LAP):
        angle = 2 * np.pi * index / SCANS_PER_LAP
        pose = se3.from_yaw(angle + np.pi / 2, (RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), 0.0))
        scans.append((rng.uniform(-20, 20, (150, 3)).astype(np.float32), pose, index * 10**8))
    folder = tmp_path_factory.mktemp("laps")
    write_kitti(folder, scans)
    return KittiRecording(folder)


def options(**changes: object) -> EvaluationOptions:
    values: dict[str, object] = {"tau": 10.0, "stride": 5.0, "jobs": 1, **changes}
    return EvaluationOptions(**values)  # type: ignore[arg-type]  # keyword arguments of several types


def test_submaps_are_windows_of_tau_metres_that_start_every_stride(recording: KittiRecording) -> None:
    windows = cut(recording, options().pipeline().submap)
    # Chords are 2.513 m: four of them pass 10 m, two pass 5 m.
    assert windows[0] == (0, 1, 2, 3, 4) and windows[1][0] == 2
    assert windows[-1][-1] == LAPS * SCANS_PER_LAP - 1


def test_a_perfect_method_finds_every_loop_with_exact_poses(recording: KittiRecording) -> None:
    # 15 m apart on a circle of 40 m is a cosine of 0.93: whatever counts as a loop is accepted.
    result = evaluate(recording, options(positive_radius=15.0), method=Compass())
    summary = result.summary
    assert summary["submaps"] == len(result.queries) == len(cut(recording, options().pipeline().submap))
    assert summary["queries_with_a_loop"] > 40
    assert summary["descriptor"]["recall_at_1"] == summary["verified"]["recall_at_5"] == 1.0
    assert summary["verified"]["accepted_near"] == summary["queries_with_a_loop"]
    assert summary["poses"]["max_m"] < 1e-5 and summary["poses"]["max_deg"] < 1e-3
    assert summary["bytes"]["neural_map"] == 100 and summary["seconds"]["stages"] == {"look": 0.5}


def test_queries_meet_only_earlier_submaps_of_places_that_were_left_and_entered_again(
    recording: KittiRecording,
) -> None:
    rows = evaluate(recording, options(), method=Compass()).queries
    # A lap has 50 submaps; the last of them lies 5 m from the first, and two before it come nearer by more than 5 m.
    assert all(row["candidate_id"] is None for row in rows[:46])
    assert rows[49]["candidate_id"] == 0
    assert all(row["id"] - row["candidate_id"] in (49, 50, 51) for row in rows[51:-1])
    assert rows[0]["verified_score"] is rows[0]["T_match_query"] is rows[0]["descriptor_candidate_id"] is None


def test_a_turned_submap_reports_the_pose_between_the_unturned_frames(recording: KittiRecording) -> None:
    straight = evaluate(recording, options(), method=Compass()).queries[-1]
    turned = evaluate(recording, options(perturbation=Perturbation(rotate_seed=7)), method=Compass()).queries[-1]
    assert turned["candidate_id"] == straight["candidate_id"]
    np.testing.assert_allclose(turned["T_match_query"], straight["T_match_query"], atol=1e-6)


def test_the_written_json_has_one_row_a_submap_and_the_documented_fields(
    recording: KittiRecording, tmp_path: Path
) -> None:
    result = evaluate(recording, options(), method=Compass())
    result.write_json(tmp_path / "out.json")
    document = json.loads((tmp_path / "out.json").read_text())
    assert set(document) == {"queries", "summary"}
    assert [row["id"] for row in document["queries"]] == list(range(document["summary"]["submaps"]))
    wanted = {
        "id", "position", "candidate_id", "candidate_position", "similarity", "verified_score", "T_match_query",
        "descriptor_candidate_id", "descriptor_candidate_position", "verdict", "reason",
    }  # fmt: skip
    assert wanted <= set(document["queries"][-1])
    assert np.shape(document["queries"][-1]["T_match_query"]) == (4, 4)


def test_a_submap_the_method_refuses_is_a_row_with_its_reason(recording: KittiRecording) -> None:
    result = evaluate(recording, options(), method=Compass(refuses_below_x=-30.0))
    refused = [row for row in result.queries if row["failure"]]
    assert refused and all(row["failure"].startswith("UNUSABLE_CLOUD") for row in refused)
    assert all(row["position"][0] < -25.0 and row["candidate_id"] is None for row in refused)
    assert result.summary["failures"] == {"UNUSABLE_CLOUD": len(refused)}


def test_a_bad_scan_is_left_out_and_counted_and_the_others_keep_their_rows(
    recording: KittiRecording, tmp_path: Path
) -> None:
    for part in ("poses.txt", "times.txt", "calib.txt"):
        shutil.copy(recording._folder / part, tmp_path / part)
    shutil.copytree(recording._folder / "velodyne", tmp_path / "velodyne")
    # Scan 0 is sampled for the scene scale too; 100 is torn, 121 is all NaN, 122 has fewer than 100 points.
    torn, blind, small = (tmp_path / "velodyne" / f"{index:06d}.bin" for index in (100, 121, 122))
    (tmp_path / "velodyne" / "000000.bin").write_bytes(b"")
    torn.write_bytes(torn.read_bytes()[:-3])
    blind.write_bytes(np.full((150, 4), np.nan, dtype="<f4").tobytes())
    small.write_bytes(small.read_bytes()[: 16 * 99])
    damaged = evaluate(KittiRecording(tmp_path), options(), method=Compass())
    assert damaged.summary["bad_scans"] == 4 and damaged.summary["failures"] == {}
    assert len(damaged.queries) == len(evaluate(recording, options(), method=Compass()).queries)
    # The middle scan of some windows is bad: poses and frames must still be those of one and the same scan.
    assert damaged.summary["poses"]["loops"] > 40 and damaged.summary["poses"]["max_m"] < 1e-5
    assert damaged.queries[0]["position"] != damaged.queries[1]["position"]


def test_scans_thinned_below_a_hundred_points_still_make_a_submap(recording: KittiRecording) -> None:
    # 150 points a scan, five scans a window: 30 % leave about 45 a scan and 225 a submap.
    result = evaluate(recording, options(perturbation=Perturbation(keep_points=0.3)), method=Compass())
    assert result.summary["failures"] == {} and result.summary["bad_scans"] == 0


@pytest.mark.slow
def test_two_processes_give_the_same_rows_as_one(recording: KittiRecording) -> None:
    alone = evaluate(recording, options(), method=Compass())
    shared = evaluate(recording, options(jobs=2), method=Compass())
    assert shared.queries == alone.queries


def test_interleaved_halves_find_each_other(recording: KittiRecording) -> None:
    result = evaluate_interleaved(recording, options(), method=Compass(), baselines=())
    assert result.queries > 30 and result.map_submaps > 30
    assert result.descriptor_recall_at_1 == result.verified_recall_at_1 == 1.0
    assert result.accepted == result.queries and result.accepted_wrong == result.accepted_false == 0
    assert result.median_error_m is not None and result.median_error_m < 1e-5


def test_a_quarter_of_the_beams_leaves_a_quarter_of_the_points_on_a_quarter_of_the_elevations() -> None:
    elevations = np.radians(np.linspace(-24.0, 2.0, 64))
    azimuth = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    grid = np.stack(np.meshgrid(elevations, azimuth), axis=-1).reshape(-1, 2)
    points = 10.0 * np.column_stack([np.cos(grid[:, 0]) * np.cos(grid[:, 1]), np.cos(grid[:, 0]) * np.sin(grid[:, 1]),
                                     np.sin(grid[:, 0])])  # fmt: skip
    kept = keep_beams(points.astype(np.float32), 16)
    assert len(np.unique(np.arcsin(kept[:, 2] / 10.0).round(4))) == pytest.approx(16, abs=1)
    assert len(kept) / len(points) == pytest.approx(0.25, abs=0.02)
    assert len(keep_beams(points.astype(np.float32), 64)) == len(points)


def test_thinning_keeps_the_share_and_is_the_same_every_time() -> None:
    points = np.random.default_rng(0).normal(size=(20_000, 3)).astype(np.float32)
    thin = Perturbation(keep_points=0.25)
    assert len(thin.thin(points, 3)) == pytest.approx(5_000, abs=250)
    np.testing.assert_array_equal(thin.thin(points, 3), thin.thin(points, 3))
    assert not np.array_equal(thin.thin(points, 3)[:100], thin.thin(points, 4)[:100])


def test_beams_are_chosen_among_those_that_a_sensor_has() -> None:
    # 32 beams from -30.67 to 10.67 degrees, as of an HDL-32; every second of them stays, up to the highest but one.
    elevation = np.radians(np.repeat(np.linspace(-30.67, 10.67, 32), 500))
    points = 20.0 * np.column_stack([np.cos(elevation), np.zeros(16_000), np.sin(elevation)]).astype(np.float32)
    kept = np.degrees(np.arctan2(*keep_beams(points, 16)[:, [2, 0]].T))
    levels = np.unique(np.round(kept, 1))
    assert len(kept) == 8_000 and len(levels) == 16
    assert (levels[0], levels[-1]) == (pytest.approx(-30.67, abs=1.4), pytest.approx(10.67, abs=1.4))
    assert len(keep_beams(points, 32)) == len(points)


@pytest.mark.parametrize("changes", [{"keep_points": 0.0}, {"keep_points": 1.5}, {"keep_beams": 0}])
def test_senseless_perturbations_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="keep_"):
        Perturbation(**changes)  # type: ignore[arg-type]  # keyword arguments of several types
