"""Verification: true revisits are aligned, everything else is rejected with its reason."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.place import Place
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.verification import (
    Authority,
    InitialPose,
    RejectedLoop,
    RejectionReason,
    VerifiedLoop,
    loop_score,
    verify,
)
from revisit.core.verification.verdict import frames_covariance, systematic_covariance
from revisit.evaluation.cutting import cut, load_submap
from revisit.evaluation.perturbations import Perturbation, turned
from revisit.evaluation.real_data import real_recording
from tests.support.real_data import needs_real_data
from tests.support.yards import CONFIG, moved, place_of_points, recognised, surface_of, thinned, yard

VERIFICATION = CONFIG.verification


@lru_cache(maxsize=8)
def place(seed: int) -> Place:
    """The place of a yard."""
    return recognised(yard(seed))[1]


@pytest.mark.parametrize("yaw_deg", [0.0, 75.0, 180.0, -120.0])
def test_a_revisit_is_verified_and_aligned_from_every_heading(yaw_deg: float) -> None:
    T_match_query = se3.from_yaw(np.radians(yaw_deg), (4.0, -3.0, 0.5))
    query = recognised(thinned(moved(yard(1), se3.inverse(T_match_query)), 0.7, seed=3))[1]
    verdict = verify(query, place(1), 0.9, VERIFICATION)
    assert isinstance(verdict, VerifiedLoop)
    error = se3.inverse(T_match_query) @ verdict.measurement.T_match_query
    assert np.linalg.norm(error[:3, 3]) < 0.05
    assert np.degrees(se3.rotation_angle(error)) < 0.3


def test_the_answer_is_between_the_submap_frames_not_the_levelled_ones() -> None:
    T_submap_upright = se3.exp([0.1, 0.0, 0.0, 0.05, -0.03, 0.0])
    plain = verify(place(1), place(1), 1.0, VERIFICATION)
    leaning = replace(place(1), frame=LevelFrame.from_upright(T_submap_upright, 1.0))
    tilted = verify(leaning, place(1), 1.0, VERIFICATION)
    assert isinstance(plain, VerifiedLoop)
    assert isinstance(tilted, VerifiedLoop)
    expected = plain.measurement.T_match_query @ se3.inverse(T_submap_upright)
    np.testing.assert_allclose(tilted.measurement.T_match_query, expected, atol=1e-12)


def test_no_two_different_places_make_a_loop() -> None:
    for query in range(1, 7):
        for match in range(1, 7):
            if query != match:
                assert isinstance(verify(place(query), place(match), 0.9, VERIFICATION), RejectedLoop)


def test_verification_gives_the_same_answer_twice() -> None:
    first, second = (verify(place(1), place(2), 0.5, VERIFICATION) for _ in range(2))
    assert first.measurement is not None
    assert second.measurement is not None
    np.testing.assert_array_equal(first.measurement.T_match_query, second.measurement.T_match_query)
    assert first.measurement.score == second.measurement.score


def rectified(seed: int, scale: float = 0.25) -> LevelFrame:
    """A tilted level frame of a small scene."""
    return LevelFrame.from_upright(se3.exp(np.random.default_rng(seed).uniform(-0.3, 0.3, 6)), scale)


def visit(seed: int, yaw_deg: float, share: float) -> Place:
    """A yard seen from elsewhere, thinned, in a tilted frame and at a scale."""
    T_new_old = se3.from_yaw(np.radians(yaw_deg), (3.0, -2.0, 0.3))
    seen = recognised(thinned(moved(yard(seed), T_new_old), share, seed=seed))[1]
    return replace(seen, frame=rectified(seed))


PAIRS = {
    "a revisit": (lambda: visit(1, 75.0, 0.7), lambda: visit(1, -20.0, 0.9)),
    "a sparse revisit": (lambda: visit(2, 170.0, 0.1), lambda: visit(2, 0.0, 0.9)),
    "other places": (lambda: visit(3, 10.0, 0.8), lambda: visit(4, 30.0, 0.8)),
    "hedges": (lambda: hedges(1), lambda: hedges(2)),
    "a degenerate place": (lambda: visit(1, 0.0, 0.7), lambda: replace(wall(60.0), frame=rectified(9))),
}


def assert_exchanged(one: VerifiedLoop | RejectedLoop, other: VerifiedLoop | RejectedLoop) -> None:
    """Both verdicts say the same, seen from either place: all numbers are equal, pose and covariance are turned."""
    assert type(one) is type(other)
    assert getattr(one, "reason", None) == getattr(other, "reason", None)
    a, b = one.measurement, other.measurement
    if a is None or b is None:
        assert a is b
        return
    for name in ("similarity", "inliers", "inlier_ratio", "overlap", "contrast", "seen_through", "rmse_m", "score"):
        assert getattr(a, name) == getattr(b, name), name
    np.testing.assert_allclose(a.T_match_query, se3.inverse(b.T_match_query), rtol=0, atol=1e-12)
    adjoint = se3.adjoint(a.T_match_query)
    np.testing.assert_allclose(a.covariance, adjoint @ b.covariance @ adjoint.T, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_a_verdict_does_not_depend_on_which_place_is_the_query(
    pair: tuple[Callable[[], Place], Callable[[], Place]],
) -> None:
    one, other = pair[0](), pair[1]()
    assert_exchanged(verify(one, other, 0.7, VERIFICATION), verify(other, one, 0.7, VERIFICATION))


def test_the_order_of_two_places_survives_storing_them() -> None:
    for one in (place(1), visit(2, 30.0, 0.5)):
        assert Place.from_blob(one.to_blob()).content_digest == one.content_digest
    assert place(1).content_digest != place(2).content_digest


def test_a_place_and_its_copy_in_another_frame_are_aligned_the_same_from_either_side() -> None:
    # Equal content has equal digests: then no order exists, and none is needed.
    copy = replace(place(1), frame=LevelFrame.from_upright(se3.exp([1.0, 2.0, 0.0, 0.1, 0.0, 2.0]), 1.0))
    one, other = verify(place(1), copy, 1.0, VERIFICATION), verify(copy, place(1), 1.0, VERIFICATION)
    assert isinstance(one, VerifiedLoop)
    assert_exchanged(one, other)


@pytest.mark.real_data
@pytest.mark.slow
@needs_real_data
def test_verdicts_on_real_submaps_do_not_depend_on_which_is_the_query(tmp_path: Path) -> None:
    recording, config = real_recording("kitti00_head", tmp_path), replace(CONFIG.submap, tau=10.0, stride=10.0)
    windows = cut(recording, config, range(0, len(recording), 2))[2:7]
    submaps = [load_submap(recording, window, config, Perturbation())[0] for window in windows]
    models = load_packaged_models()
    places = [describe(turned(submap, 0.7 * k), models, CONFIG).place for k, submap in enumerate(submaps)]
    verdicts = {}
    for a, b in itertools.permutations(range(len(places)), 2):
        verdicts[a, b] = verify(places[a], places[b], 0.5, VERIFICATION)
    for a, b in itertools.combinations(range(len(places)), 2):
        assert_exchanged(verdicts[a, b], verdicts[b, a])
    # Neighbouring submaps of a street share enough to be loops, so that not all of these verdicts are rejections.
    assert sum(isinstance(verdict, VerifiedLoop) for verdict in verdicts.values()) >= 6


def test_the_covariance_is_symmetric_and_positive() -> None:
    verdict = verify(place(1), place(1), 1.0, VERIFICATION)
    assert isinstance(verdict, VerifiedLoop)
    covariance = verdict.measurement.covariance
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_many_points_do_not_make_a_pose_surer_than_the_submaps_are() -> None:
    sure = replace(VERIFICATION, correlated_points=1e-6)
    small = replace(place(1), frame=LevelFrame(scale=0.25))
    for one in (place(1), small):
        verdict = verify(one, one, 1.0, sure)
        assert isinstance(verdict, VerifiedLoop)
        deviations = np.sqrt(np.diag(verdict.measurement.covariance))
        floor = [0.022, 0.022, 0.011, *np.radians([0.1, 0.1, 0.055])]
        np.testing.assert_allclose(deviations, floor, rtol=1e-3)


def test_the_less_is_shared_and_the_farther_apart_the_less_sure_a_loop_is() -> None:
    away = se3.from_yaw(0.3, (10.0, 0.0, 0.0))
    half = np.sqrt(np.diag(systematic_covariance(np.eye(4), 0.5, 1.0, VERIFICATION)))
    tilt, yaw = np.radians([np.hypot(0.1, 0.13), np.hypot(0.055, 0.09)])
    np.testing.assert_allclose(half, [*[np.hypot(0.022, 0.04)] * 2, np.hypot(0.011, 0.04), tilt, tilt, yaw])
    third = np.sqrt(np.diag(systematic_covariance(np.eye(4), 1 / 3, 1.0, VERIFICATION)))
    assert third[0] == pytest.approx(np.hypot(0.022, 0.08))
    aside = np.sqrt(np.diag(systematic_covariance(away, 1.0, 1.0, VERIFICATION)))
    lever = 10.0 * np.radians(0.3)
    along, down = np.hypot(0.022, 10.0 * 0.005), np.hypot(0.011, 10.0 * 0.003)
    np.testing.assert_allclose(aside[:3], [along, np.hypot(along, lever), np.hypot(down, lever)])
    turns = np.radians([np.hypot(*of) for of in ((0.1, 0.06), (0.1, 0.06), (0.055, 0.18))])
    np.testing.assert_allclose(aside[3:], turns)
    in_scene = np.sqrt(np.diag(systematic_covariance(np.eye(4), 0.5, 0.25, VERIFICATION)))
    np.testing.assert_allclose(in_scene, half * [4, 4, 4, 1, 1, 1])
    away[:3, 3] *= 4.0  # 10 m of a scene of a quarter
    small = np.sqrt(np.diag(systematic_covariance(away, 1.0, 0.25, VERIFICATION)))
    np.testing.assert_allclose(small, aside * [4, 4, 4, 1, 1, 1])


def test_scans_that_agree_make_a_loop_surer_and_an_askew_sensor_less_sure() -> None:
    away, half = se3.from_yaw(0.0, (10.0, 0.0, 0.0)), 0.5
    unknown = np.sqrt(np.diag(systematic_covariance(away, half, 1.0, VERIFICATION)))
    told = ScanDisagreement(surface=np.hypot(0.005, 0.005), askew=np.radians(0.1))
    partly = np.sqrt(np.diag(systematic_covariance(away, half, 1.0, VERIFICATION, told)))
    assert partly[0] == pytest.approx(unknown[0] / 2)
    assert partly[1] == pytest.approx(np.hypot(unknown[0] / 2, 10.0 * np.radians(0.1)))
    worse = ScanDisagreement(surface=0.03, askew=np.radians(1.0))
    assert systematic_covariance(away, half, 1.0, VERIFICATION, worse)[1, 1] > unknown[1] ** 2
    assert systematic_covariance(away, half, 1.0, VERIFICATION, worse)[0, 0] == pytest.approx(unknown[0] ** 2)


def test_what_the_scans_of_one_place_tell_is_not_taken_for_both() -> None:
    agreeing = replace(place(1), scan_disagreement=ScanDisagreement(0.0, 0.0))
    alone, both = (verify(agreeing, other, 1.0, VERIFICATION) for other in (place(1), agreeing))
    assert isinstance(alone, VerifiedLoop) and isinstance(both, VerifiedLoop)
    assert alone.measurement.covariance[0, 0] > 0.022**2 > 4.0 * both.measurement.covariance[0, 0]


def test_what_frames_are_off_by_themselves_adds_to_a_loop_that_both_sides_tell_it_of() -> None:
    T_match_query, turn = se3.from_yaw(0.5 * np.pi, (10.0, 0.0, 0.0)), np.radians(0.1)
    off, exact = ScanDisagreement(0.0, 0.0, 0.02, turn), ScanDisagreement(0.0, 0.0)
    of_match = np.sqrt(np.diag(frames_covariance(T_match_query, exact, off, 1.0)))
    np.testing.assert_allclose(of_match, [0.02, 0.02, 0.02, turn, turn, turn])
    of_query = np.sqrt(np.diag(frames_covariance(T_match_query, off, exact, 0.5)))
    lever = np.hypot(0.01, 10.0 * turn)  # the query lies 10 m along x
    np.testing.assert_allclose(of_query, [0.01, lever, lever, turn, turn, turn])
    deviations = {}
    for stated in (off, exact):
        one = replace(place(1), scan_disagreement=stated)
        verdict = verify(one, one, 1.0, VERIFICATION)
        assert isinstance(verdict, VerifiedLoop)
        deviations[stated] = np.diag(verdict.measurement.covariance)
    np.testing.assert_allclose(deviations[off] - deviations[exact], 2.0 * np.square([0.02] * 3 + [turn] * 3), rtol=1e-6)


def test_the_error_of_a_made_up_revisit_lies_within_what_the_covariance_says() -> None:
    for seed in range(1, 5):
        T_match_query = se3.from_yaw(0.4 * seed, (2.0, -1.0, 0.3))
        query = recognised(thinned(moved(yard(seed), se3.inverse(T_match_query)), 0.6, seed=3))[1]
        verdict = verify(query, place(seed), 0.9, VERIFICATION)
        assert isinstance(verdict, VerifiedLoop)
        error = se3.log(verdict.measurement.T_match_query @ se3.inverse(T_match_query))
        assert error @ np.linalg.solve(verdict.measurement.covariance, error) < 12.6  # 95 % of chi square of 6


def test_places_of_different_codebooks_are_never_compared() -> None:
    with pytest.raises(DescriptorModelMismatch):
        verify(place(1), replace(place(1), model="another"), 0.9, VERIFICATION)


def wall(length_m: float) -> Place:
    """One straight wall facing +y, seen from the origin."""
    x, z = np.meshgrid(np.arange(-length_m / 2, length_m / 2, 0.5), np.arange(-1.5, 4.0, 0.5))
    points = np.stack([x.ravel(), np.full(x.size, 5.0), z.ravel()], axis=1)
    return place_of_points(points, np.tile([0.0, -1.0, 0.0], (len(points), 1)))


def corridor() -> Place:
    """Two parallel walls of 60 m."""
    one = wall(60.0)
    other = one.points * np.array([1, -1, 1], np.float32)
    points = np.concatenate([one.points, other])
    return place_of_points(points, np.concatenate([one.normals, -one.normals]))


def hedges(seed: int) -> Place:
    """Two rough hedges of 60 m along a street; every seed sees other leaves of them."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-30, 30, 2000), rng.normal(5.0, 0.1, 2000), rng.uniform(-1.5, 1.0, 2000)])
    normals = np.column_stack([rng.normal(0, 0.3, 2000), np.full(2000, -1.0), rng.normal(0, 0.2, 2000)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    side = np.where(rng.random(2000) < 0.5, 1.0, -1.0)[:, None] * [0, 1, 0] + [1, 0, 1]
    return place_of_points(points * side, normals * side)


def test_one_wall_is_a_degenerate_place() -> None:
    verdict = verify(wall(60.0), wall(60.0), 1.0, VERIFICATION)
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is RejectionReason.DEGENERATE_PLACE


def test_a_place_on_which_nothing_stands_is_degenerate() -> None:
    verdict = verify(replace(place(1), standing_count=0), place(1), 1.0, VERIFICATION)
    assert verdict == RejectedLoop(RejectionReason.DEGENERATE_PLACE)


def test_a_corridor_never_makes_a_loop_because_its_length_is_not_observed() -> None:
    verdict = verify(corridor(), corridor(), 1.0, VERIFICATION)
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is RejectionReason.DEGENERATE_ALIGNMENT


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"min_common": 10**6}, RejectionReason.NO_COMMON_REGION),
        ({"min_overlap": 1.0}, RejectionReason.LOW_OVERLAP),
        ({"max_seen_through": 0.0}, RejectionReason.SEEN_THROUGH),
        ({"min_score": 1.0}, RejectionReason.LOW_SCORE),
        ({"max_tilt": 0.0}, RejectionReason.IMPLAUSIBLE_TILT),
    ],
)
def test_each_gate_rejects_with_its_own_reason_and_keeps_the_evidence(
    change: dict[str, float], reason: RejectionReason
) -> None:
    # Tilted, thinned, and with three new buildings where the first visit looked through.
    changed = moved(yard(1, buildings=17), se3.exp([4.0, -3.0, 0.5, 0.03, 0.0, 1.0]))
    revisit = recognised(thinned(changed, 0.7, seed=3))[1]
    assert isinstance(verify(revisit, place(1), 1.0, VERIFICATION), VerifiedLoop)
    verdict = verify(revisit, place(1), 1.0, replace(VERIFICATION, **change))
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is reason
    assert verdict.measurement is not None


@pytest.mark.parametrize("change", [{"sure_overlap": 1.0}, {"sure_score": 1.0}, {"min_common_share_sure": 1.0}])
def test_less_of_a_place_need_be_common_only_where_overlap_and_score_leave_no_doubt(change: dict[str, float]) -> None:
    """As of two sensors that look at unlike parts of a place."""
    revisit = recognised(thinned(yard(1), 0.7, seed=3))[1]
    strict = replace(VERIFICATION, min_common_share=1.0)
    assert isinstance(verify(revisit, place(1), 1.0, replace(strict, sure_score=0.5)), VerifiedLoop)
    verdict = verify(revisit, place(1), 1.0, replace(strict, **{"sure_score": 0.5, **change}))
    assert isinstance(verdict, RejectedLoop) and verdict.reason is RejectionReason.NO_COMMON_REGION
    told = verdict.measurement
    assert told is not None and VERIFICATION.min_common_share < told.common_share < told.enough_share == 1.0


def test_contrast_raises_the_score_and_contradictions_and_residuals_lower_it() -> None:
    assert loop_score(0.5, 0.3, 0.05, 0.1, 20) > loop_score(0.5, 0.2, 0.05, 0.1, 20)
    assert loop_score(0.5, 0.3, 0.05, 0.1, 20) > loop_score(0.5, 0.3, 0.15, 0.1, 20)
    assert loop_score(0.5, 0.3, 0.05, 0.1, 20) > loop_score(0.5, 0.3, 0.05, 0.12, 20)


def test_contrast_counts_by_the_overlap_of_which_it_is_a_part() -> None:
    assert loop_score(0.3, 0.15, 0.02, 0.12, 20) > loop_score(0.6, 0.15, 0.02, 0.12, 20)


def test_few_keypoints_that_agree_lower_the_score_and_many_do_not_raise_it() -> None:
    assert loop_score(0.3, 0.15, 0.02, 0.12, 5) < loop_score(0.3, 0.15, 0.02, 0.12, 12)
    assert loop_score(0.3, 0.15, 0.02, 0.12, 0) > 0.0
    assert loop_score(0.3, 0.15, 0.02, 0.12, 12) == loop_score(0.3, 0.15, 0.02, 0.12, 60)


def test_two_bends_of_a_street_canyon_score_too_low_and_two_visits_to_a_wood_do_not() -> None:
    """As measured on simulated drives: the best wrong pair, and a right one that scores least."""
    assert (
        loop_score(0.285, 0.111, 0.035, 0.116, 6) < VERIFICATION.min_score < loop_score(0.245, 0.119, 0.026, 0.121, 10)
    )


def test_a_place_and_itself_see_nothing_through_each_other() -> None:
    verdict = verify(place(1), place(1), 1.0, VERIFICATION)
    assert verdict.measurement is not None and verdict.measurement.seen_through < 0.01


def test_a_house_among_others_has_contrast_and_a_hedge_along_the_street_has_none() -> None:
    yard_loop = verify(place(1), place(1), 1.0, VERIFICATION)
    assert isinstance(yard_loop, VerifiedLoop) and yard_loop.measurement.contrast > 0.3
    verdict = verify(hedges(1), hedges(2), 1.0, VERIFICATION)
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is RejectionReason.DEGENERATE_ALIGNMENT
    assert verdict.measurement is not None and verdict.measurement.contrast < VERIFICATION.min_contrast


def houses_along_a_street(seed: int, shift_m: float) -> Place:
    """Equal houses every 10 m along a street, sampled anew in every visit, seen 30 m around from `shift_m` on."""
    rng = np.random.default_rng(seed)
    parts = [np.column_stack([rng.uniform(-35, 35, (6000, 2)), np.full(6000, -1.5)])]
    normals = [np.tile([0.0, 0.0, 1.0], (6000, 1))]
    for x in np.arange(-50.0, 51.0, 10.0) - shift_m:
        for side in (-1.0, 1.0):
            for point, normal in (([0, 9, 0], [0, -1, 0]), ([4, 10, 0], [1, 0, 0]), ([-4, 10, 0], [-1, 0, 0])):
                along = np.array([abs(normal[1]) * 4.0, abs(normal[0]) * 2.0, 0.0])
                steps = rng.uniform(-1, 1, (400, 1)) * along + rng.uniform(-1.5, 4, (400, 1)) * [0, 0, 1]
                parts.append((np.array(point) + steps) * [1, side, 1] + [x, 0, 0])
                normals.append(np.tile(np.array(normal) * [1.0, side, 1.0], (400, 1)))
    points, facing = np.concatenate(parts), np.concatenate(normals)
    near = np.linalg.norm(points[:, :2], axis=1) < 30.0
    return recognised(surface_of(points[near], facing[near]))[1]


@pytest.mark.parametrize("min_score", [VERIFICATION.min_score, 1.0])
def test_the_next_of_many_equal_houses_is_ambiguous_and_the_rivals_are_told(min_score: float) -> None:
    config = replace(VERIFICATION, min_score=min_score)
    verdict = verify(houses_along_a_street(1, 0.0), houses_along_a_street(2, 3.0), 0.9, config)
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is RejectionReason.AMBIGUOUS
    assert verdict.measurement is not None
    rivals = verdict.measurement.rivals
    poses = [verdict.measurement.T_match_query, *(rival.T_match_query for rival in rivals)]
    assert any(abs(T[0, 3] + 3.0) < 0.3 and T[0, 0] > 0.99 for T in poses)
    assert any(abs(T[0, 3] - 7.0) < 0.3 and T[0, 0] > 0.99 for T in poses)
    assert [rival.overlap for rival in rivals] == sorted((rival.overlap for rival in rivals), reverse=True)


def test_a_yard_that_does_not_repeat_has_no_rivals() -> None:
    verdict = verify(recognised(thinned(yard(1), 0.6, seed=3))[1], place(1), 0.9, VERIFICATION)
    assert isinstance(verdict, VerifiedLoop)
    assert verdict.measurement.rivals == ()


def test_an_ambiguous_verdict_does_not_depend_on_which_place_is_the_query() -> None:
    one, other = houses_along_a_street(1, 0.0), replace(houses_along_a_street(2, 3.0), frame=rectified(3, 1.0))
    forward, backward = verify(one, other, 0.9, VERIFICATION), verify(other, one, 0.9, VERIFICATION)
    assert_exchanged(forward, backward)
    assert forward.measurement is not None and backward.measurement is not None
    assert forward.measurement.rivals
    for here, there in zip(forward.measurement.rivals, backward.measurement.rivals, strict=True):
        assert here.overlap == there.overlap
        np.testing.assert_allclose(here.T_match_query, se3.inverse(there.T_match_query), rtol=0, atol=1e-12)


def test_a_pose_given_up_early_counts_as_the_worst_evidence() -> None:
    verdict = verify(place(1), place(2), 1.0, replace(VERIFICATION, min_agreement=1.0))
    assert verdict.measurement is not None
    assert (verdict.measurement.contrast, verdict.measurement.seen_through) == (0.0, 1.0)
    assert verdict.measurement.score < 1e-3


def test_a_start_that_is_named_decides_among_equal_houses_only_where_it_may() -> None:
    places = houses_along_a_street(1, 0.0), houses_along_a_street(2, 3.0)
    near = se3.from_yaw(0.0, (-3.0, 0.0, 0.0))
    assert isinstance(verify(*places, 0.9, VERIFICATION, InitialPose(near)), VerifiedLoop)
    verdict = verify(*places, 0.9, VERIFICATION, InitialPose(near, Authority.COMPETES))
    assert isinstance(verdict, RejectedLoop) and verdict.reason is RejectionReason.AMBIGUOUS
    assert verdict.measurement is not None and abs(verdict.measurement.T_match_query[0, 3] + 3.0) < 0.3


@pytest.mark.parametrize("matched", [1, 2], ids=["the same yard", "another yard"])
def test_a_wrong_guess_changes_nothing(matched) -> None:
    wrong = InitialPose(se3.from_yaw(1.5, (15.0, 9.0, 0.0)), Authority.HINT)
    guessed, without = (verify(place(1), place(matched), 0.9, VERIFICATION, one) for one in (wrong, None))
    assert type(guessed) is type(without)
    assert guessed.measurement is not None and without.measurement is not None
    np.testing.assert_array_equal(guessed.measurement.T_match_query, without.measurement.T_match_query)


def test_a_right_guess_gives_the_loop_that_is_found_without_it() -> None:
    near = InitialPose(se3.from_yaw(0.03, (0.4, -0.3, 0.1)), Authority.HINT)
    guessed, without = (verify(place(1), place(1), 0.9, VERIFICATION, one) for one in (near, None))
    assert isinstance(guessed, VerifiedLoop) and isinstance(without, VerifiedLoop)
    np.testing.assert_allclose(guessed.measurement.T_match_query, without.measurement.T_match_query, atol=5e-3)
    assert guessed.measurement.score == pytest.approx(without.measurement.score, abs=0.01)


def test_a_guess_decides_nothing_among_equal_houses() -> None:
    places = houses_along_a_street(1, 0.0), houses_along_a_street(2, 3.0)
    verdict = verify(*places, 0.9, VERIFICATION, InitialPose(se3.from_yaw(0.0, (-3.0, 0.0, 0.0)), Authority.HINT))
    assert isinstance(verdict, RejectedLoop) and verdict.reason is RejectionReason.AMBIGUOUS
