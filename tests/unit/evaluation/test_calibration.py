from __future__ import annotations

import numpy as np
import pytest

from revisit.evaluation.calibration import (
    NullSimilarities,
    Threshold,
    TooFewPlaces,
    allowed_rank,
    calibrate,
    count_distinct,
    null_similarities,
    places_needed,
)
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.loop_closure_method import Description
from revisit.evaluation.matching import QueryMatches
from revisit.evaluation.summary import summarise


def along_a_line(*metres):
    return np.array([[x, 0.0, 0.0] for x in metres])


def test_the_highest_of_59_places_holds_five_percent_and_the_second_highest_of_93():
    # Wilks (1941): 1 - 0.95^59 = 0.9515, 1 - 0.95^58 = 0.9490.
    assert [allowed_rank(m, 0.05, 0.95) for m in (58, 59, 92, 93)] == [0, 1, 1, 2]
    assert [places_needed(rate, 0.95) for rate in (0.1, 0.05, 0.01)] == [29, 59, 299]


def test_the_threshold_is_the_rank_that_the_number_of_places_allows():
    null = NullSimilarities(np.arange(93) / 100.0, distinct_places=93)
    assert calibrate(null, 0.05) == Threshold(0.91, 0.05, 0.95)


def test_a_rate_that_the_places_cannot_support_is_refused():
    null = NullSimilarities(np.linspace(0.0, 0.5, 58), distinct_places=58)
    assert calibrate(null, 0.05) == TooFewPlaces(58, needed=59)
    assert calibrate(NullSimilarities(np.zeros(0), 0), 0.1) == TooFewPlaces(0, needed=29)


def test_neighbouring_submaps_do_not_count_as_more_evidence():
    values = np.repeat(np.arange(93) / 100.0, 10)
    assert isinstance(calibrate(NullSimilarities(values, 93), 0.01), TooFewPlaces)
    # Each value ten times: the twentieth highest of them all is the second highest of the distinct ones.
    assert calibrate(NullSimilarities(values, 93), 0.05) == Threshold(0.91, 0.05, 0.95)


@pytest.mark.parametrize(("rate", "confidence"), [(0.0, 0.95), (1.0, 0.95), (0.05, 0.0), (0.05, 1.0), (np.nan, 0.95)])
def test_a_rate_or_confidence_outside_0_to_1_is_refused(rate, confidence):
    with pytest.raises(ValueError, match=r"must lie in \(0, 1\)"):
        calibrate(NullSimilarities(np.zeros(99), 99), rate, confidence)


def test_the_promise_holds_as_often_as_it_says():
    rng = np.random.default_rng(7)
    thresholds = [calibrate(NullSimilarities(rng.random(93), 93), 0.05) for _ in range(2000)]
    # A uniform null exceeds t at the rate 1 - t. Promised: at most 5 % in 95 % of the maps; exactly 95.02 % for
    # the second highest of 93. Three standard deviations of 2000 draws are 1.5 %.
    kept = np.mean([1.0 - threshold.similarity <= 0.05 for threshold in thresholds])
    assert kept == pytest.approx(0.9502, abs=0.015)


def test_only_places_that_are_far_apart_whatever_the_drift_tell_of_false_alarms():
    vectors = np.array([[1.0, 0.0], [0.6, 0.8], [0.0, 1.0], [0.8, 0.6]], dtype=np.float32)
    # Driven out and back: the fourth lies 101 m from the first, but after 301 m odometry may be 6 m wrong.
    null = null_similarities(vectors, along_a_line(0.0, 50.0, 201.0, 101.0))
    # First-third 0.0 and second-third 0.8 are far; third-fourth are 100 m apart, not more.
    assert null.similarity == pytest.approx([0.0, 0.8, 0.8])
    assert null.distinct_places == 3


def test_a_map_of_one_place_has_no_null():
    null = null_similarities(np.ones((3, 1), dtype=np.float32), along_a_line(0.0, 10.0, 20.0))
    assert len(null.similarity) == 0 and null.distinct_places == 0
    assert null_similarities(np.zeros((0, 4), dtype=np.float32), np.zeros((0, 3))).distinct_places == 0


def test_a_street_driven_twice_counts_once():
    there = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    # Kept 0, 30, and nothing on the way back: 60 would be next.
    assert count_distinct(along_a_line(*there, *there[::-1]), 20.0) == 2
    assert count_distinct(along_a_line(*there, 60.0), 20.0) == 3


def test_an_evaluation_names_the_similarity_for_each_rate_that_its_places_support():
    # Thirty places 200 m apart that have nothing in common, but for the last, which looks 0.6 like the first.
    vectors = np.eye(30, dtype=np.float32)
    vectors[29] = 0.6 * vectors[0] + 0.8 * vectors[29]
    places = [
        DescribedSubmap(i, (i,), np.array([200.0 * i, 0.0, 0.0]), np.eye(4), 0.0, Description(vector, b""), None, 1,
              seconds={"load": 0.0, "describe": 0.0})
        for i, vector in enumerate(vectors)
    ]  # fmt: skip
    thresholds = summarise(places, [QueryMatches((), (), 0.0)] * 30, np.zeros((30, 30), bool))["thresholds"]
    assert thresholds["distinct_places"] == 30
    assert thresholds["min_similarity"] == {"10%": pytest.approx(0.6), "5%": None, "1%": None}
