"""The best of several claims, the claims that tell of their drive, and pairs tested from the poses of a map."""

from __future__ import annotations

import pytest

from revisit.core.acceptance import MOST_MOVED_M, Doubt, accept_chosen, accept_near, best_loop
from revisit.core.config import VerificationConfig
from revisit.core.pair_verdict import RejectedLoop, RejectionReason, VerifiedLoop
from tests.support.claims import along_x, at, doubted, pair
from tests.support.verdicts import rejected, verified

HERE = [along_x(1.0)]


def scored(score: float, reason: str | None = None):
    return pair(at(0.0), at(50.0, drive=0), HERE, reason, score)


def test_the_best_is_the_loop_of_the_highest_score_and_the_first_of_equal_ones():
    claims = [scored(0.7), scored(0.99, "LOW_OVERLAP"), scored(0.8), scored(0.8)]
    assert best_loop(claims) == 2
    assert best_loop([*claims[:2], doubted(claims[2], Doubt.PERCEPTUAL_ALIAS)]) == 0
    assert best_loop(claims[1:2]) is None and best_loop([]) is None


@pytest.mark.parametrize(
    ("claim", "tells"),
    [
        (scored(0.9), True),
        (scored(0.9, "AMBIGUOUS"), True),
        (doubted(scored(0.9), Doubt.PAIRWISE_INCONSISTENT), True),
        (scored(0.4, "LOW_SCORE"), True),
        (scored(0.4, "LOW_OVERLAP"), False),
        (pair(at(0.0), at(50.0, drive=0), [], "NO_COMMON_REGION"), False),
    ],
    ids=["loop", "ambiguous", "doubted", "low score", "low overlap", "no pose"],
)
def test_loops_ambiguous_claims_and_low_scores_tell_of_their_drive(claim, tells):
    assert claim.tells == tells


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_a_pair_passes_near_the_pose_of_its_map_alone(scale):
    said = along_x(10.0)
    near, far = (along_x(10.0 + share * MOST_MOVED_M * scale) for share in (0.9, 1.1))
    assert isinstance(accept_near(verified(near), said, MOST_MOVED_M * scale), VerifiedLoop)
    refused = accept_near(verified(far), said, MOST_MOVED_M * scale)
    assert isinstance(refused, RejectedLoop) and refused.reason is RejectionReason.FAR_FROM_MAP
    no = rejected()
    assert accept_near(no, said, MOST_MOVED_M * scale) is no


def test_a_pair_that_anchors_chose_needs_no_score_and_passes_all_other_checks():
    said, config = along_x(10.0), VerificationConfig()
    low = rejected("LOW_SCORE", along_x(10.4))
    assert isinstance(accept_chosen(low, said, config), VerifiedLoop)
    assert isinstance(accept_chosen(verified(along_x(10.4)), said, config), VerifiedLoop)
    for other in (rejected("SEEN_THROUGH", along_x(10.4)), rejected("LOW_OVERLAP", along_x(10.4)), rejected()):
        assert accept_chosen(other, said, config) is other
    far = accept_chosen(rejected("LOW_SCORE", along_x(11.0)), said, config)
    assert isinstance(far, RejectedLoop) and far.reason is RejectionReason.FAR_FROM_MAP
