"""The paper's figures on cases small enough for pencil and paper."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.evaluation.metrics import (
    LoopProtocol,
    Outcomes,
    area_under_curve,
    average_precision,
    best_f1,
    extended_precision,
    loop_segments,
    mean_auc,
    positive_pairs,
    precision_recall,
    recall_at,
    recall_at_full_precision,
    score_recognition,
)


def outcomes(rows: list[tuple[float, bool, bool]]) -> Outcomes:
    score, correct, has_loop = zip(*rows, strict=True)
    return Outcomes(np.array(score), np.array(correct), np.array(has_loop))


# Four queries, three with a loop: right at 0.9, wrong at 0.8 although a loop exists, right at 0.7, no loop at 0.6.
CASE = [(0.9, True, True), (0.8, False, True), (0.7, True, True), (0.6, False, False)]


def test_precision_and_recall_follow_the_papers_definition() -> None:
    curve = precision_recall(outcomes(CASE))
    np.testing.assert_allclose(curve.threshold, [0.9, 0.8, 0.7, 0.6])
    np.testing.assert_allclose(curve.precision, [1.0, 1 / 2, 2 / 3, 2 / 4])
    # FN counts queries with a loop that were not accepted: 2, 1, 0, 0; so recall is 1/3, 1/2, 2/2, 2/2.
    np.testing.assert_allclose(curve.recall, [1 / 3, 1 / 2, 1.0, 1.0])
    np.testing.assert_allclose(curve.recall_over_loops, [1 / 3, 1 / 3, 2 / 3, 2 / 3])


def test_the_area_is_the_trapezoid_with_the_first_precision_prepended() -> None:
    curve = precision_recall(outcomes(CASE))
    expected = 1 / 3 * 1.0 + 1 / 6 * 0.75 + 1 / 2 * (1 / 2 + 2 / 3) / 2 + 0.0
    assert area_under_curve(curve.precision, curve.recall) == pytest.approx(expected)


def test_the_best_f1_comes_with_its_threshold() -> None:
    f1, threshold = best_f1(precision_recall(outcomes(CASE)))
    assert f1 == pytest.approx(2 * (2 / 3) * 1.0 / (2 / 3 + 1.0))
    assert threshold == pytest.approx(0.7)


def test_average_precision_counts_only_queries_with_a_loop() -> None:
    assert average_precision(precision_recall(outcomes(CASE))) == pytest.approx(1 / 3 * 1.0 + 1 / 3 * 2 / 3)


def test_recall_at_full_precision_stops_at_the_first_wrong_match() -> None:
    curve = precision_recall(outcomes(CASE))
    assert recall_at_full_precision(curve) == pytest.approx(1 / 3)
    assert extended_precision(curve) == pytest.approx((1.0 + 1 / 3) / 2)


def test_equal_scores_are_accepted_together_whatever_their_order() -> None:
    tied = [(0.5, True, True), (0.5, False, True), (0.5, False, False)]
    for rows in (tied, tied[::-1]):
        curve = precision_recall(outcomes(rows))
        np.testing.assert_allclose(curve.precision, [1 / 3])
        np.testing.assert_allclose(curve.recall, [1.0])
        assert recall_at_full_precision(curve) == 0.0


def test_a_query_without_a_match_is_a_miss_where_its_loop_exists() -> None:
    curve = precision_recall(outcomes([(0.9, True, True), (-np.inf, False, True), (-np.inf, False, False)]))
    np.testing.assert_allclose(curve.precision, [1.0])
    np.testing.assert_allclose(curve.recall, [0.5])


def test_a_perfect_ranking_scores_one_everywhere() -> None:
    scores = score_recognition(
        outcomes([(0.9, True, True), (0.8, True, True), (0.1, False, False)]), np.array([0, 0, 1]), draws=20
    )
    assert scores.auc.value == scores.max_f1.value == scores.average_precision == 1.0
    assert scores.recall_at_full_precision == scores.extended_precision == scores.recall_over_loops == 1.0
    assert (scores.queries, scores.matches, scores.loops) == (3, 3, 2)


def test_nothing_matched_scores_zero_and_does_not_fail() -> None:
    scores = score_recognition(outcomes([(-np.inf, False, True)] * 3), np.zeros(3, np.int64), draws=5)
    assert scores.auc.value == scores.max_f1.value == scores.recall_at_full_precision == 0.0
    assert scores.max_f1_threshold is None


def test_the_interval_holds_the_value_and_is_the_same_for_the_same_seed() -> None:
    rng = np.random.default_rng(0)
    correct = rng.random(120) < 0.7
    rows = Outcomes(np.where(correct, 0.5, 0.3) + 0.3 * rng.random(120), correct, np.ones(120, dtype=bool))
    segments = np.arange(120) // 10
    first, again = (score_recognition(rows, segments, draws=60, seed=4) for _ in range(2))
    assert first == again
    assert first.auc.low < first.auc.value < first.auc.high
    assert first.auc.high - first.auc.low > 0.01


def test_the_mean_of_recordings_and_their_paired_difference() -> None:
    has_loop = np.tile(np.repeat([True, False], 5), 6)
    good = Outcomes(np.where(has_loop, 0.9, 0.1), has_loop, has_loop)
    # Every other loop is matched wrongly and surely: half of the loops count as right.
    missed = has_loop & (np.arange(60) % 2 == 0)
    poor = Outcomes(np.where(has_loop, 0.9, 0.1), has_loop & ~missed, has_loop)
    mean, difference = mean_auc([good, poor]), mean_auc([good, poor], [poor, poor])
    apart = [score_recognition(one, loop_segments(has_loop)).auc.value for one in (good, poor)]
    assert mean.value == pytest.approx(np.mean(apart))
    assert difference.value == pytest.approx((apart[0] - apart[1]) / 2)
    assert 0.0 < difference.low <= difference.value <= difference.high
    same = mean_auc([poor, good], [poor, good])
    assert (same.value, same.low, same.high) == (0.0, 0.0, 0.0)


def test_segments_change_where_loops_begin_and_end() -> None:
    flags = np.array([False, False, True, True, False, True])
    np.testing.assert_array_equal(loop_segments(flags), [0, 0, 1, 1, 2, 3])


def test_a_long_segment_ends_by_itself() -> None:
    np.testing.assert_array_equal(loop_segments(np.ones(5, dtype=bool), longest=2), [0, 0, 1, 1, 2])


def test_draws_without_any_loop_do_not_pull_the_interval_to_zero() -> None:
    # Ten segments, one of which holds the only loops: a third of all draws would miss it.
    has_loop = np.arange(100) < 10
    rows = Outcomes(np.where(has_loop, 0.9, 0.1), has_loop, has_loop)
    scores = score_recognition(rows, np.arange(100) // 10, draws=50)
    assert scores.auc.low == scores.auc.value == 1.0


def test_a_loop_needs_a_near_position_and_a_larger_index_gap() -> None:
    positions = np.array([[0.0, 0, 0], [20.0, 0, 0], [20.1, 0, 0], [0.0, 0, 0]])
    pairs = positive_pairs(positions, LoopProtocol(positive_radius_m=20.0, min_index_gap=1))
    # Query 3 is 20.0 m from submap 1 (within, gap 2) and 0 m from submap 0; query 2 is 20.1 m from submap 0: too far.
    np.testing.assert_array_equal(np.argwhere(pairs), [[3, 0], [3, 1]])


def test_recall_at_k_looks_only_at_queries_with_a_loop() -> None:
    positives = np.zeros((4, 4), dtype=bool)
    positives[2, 0] = positives[3, 1] = True
    ranked = [[], [], [0], [2, 1]]
    assert recall_at(ranked, positives, 1) == 0.5
    assert recall_at(ranked, positives, 2) == 1.0


def test_a_nan_score_is_refused() -> None:
    with pytest.raises(ValueError, match="NaN"):
        outcomes([(float("nan"), True, True)])
