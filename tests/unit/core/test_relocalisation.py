"""A conversation: made-up pairs of a view with places narrow down where the robot is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from revisit.core.acceptance import Doubt, LoopClaim, Station, StationInMap
from revisit.core.acceptance.claim import Grounds
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.pair_verdict import Hypothesis, LoopMeasurement, RejectedLoop, RejectionReason, VerifiedLoop
from revisit.core.relocalisation.answer import RelocalisationState as State
from revisit.core.relocalisation.answer import UnknownReason
from revisit.core.relocalisation.conversation import Relocalisation, View

CONFIG = PipelineConfig()
HERE = StationInMap("frame-1", np.eye(4))
CLOUD = Station(None, 0, np.eye(4))
STEP_M = CONFIG.submap.tau


def measured(T_match_query, overlap=0.6, rivals=()):
    return LoopMeasurement(
        0.8, 40, 0.5, overlap, 0.5, 0.0, 0.05, 0.9, T_match_query, 0.01 * np.eye(6),
        tuple(Hypothesis(overlap, pose) for pose in rivals),
    )  # fmt: skip


def claim(verdict):
    return LoopClaim(CLOUD, Station(0, 0, np.eye(4)), verdict)


def loop(pose, overlap=0.6):
    """A pair that was accepted at a pose in the map."""
    return claim(VerifiedLoop(measured(pose, overlap)))


def ambiguous(*poses, overlap=0.6):
    """A pair that fits at several poses."""
    return claim(RejectedLoop(RejectionReason.AMBIGUOUS, measured(poses[0], overlap, poses[1:])))


def rejected(pose, overlap=0.05, reason=RejectionReason.LOW_OVERLAP):
    return claim(RejectedLoop(reason, measured(pose, overlap)))


def at(x_m, y_m=0.0):
    return se3.from_yaw(0.0, (x_m, y_m, 0.0))


def view(step, claims, near=()):
    """The view after so many steps along x of the odometry."""
    return View(at(step * STEP_M), step * STEP_M, claims, [HERE] * len(claims), near)


def along(x_m, step):
    """The pose in the map of a robot that began at x."""
    return at(x_m + step * STEP_M)


def test_an_accepted_pair_places_the_robot_at_once():
    answer = Relocalisation(CONFIG).observe(view(0, [loop(at(40.0)), rejected(at(300.0))]))
    assert answer.state is State.PLACED
    np.testing.assert_allclose(answer.poses[0].T_frame_view, at(40.0))
    assert answer.poses[0].probability + answer.none_of_them <= 1.0 + 1e-9
    assert answer.poses[0].accepted == 1


def test_a_pose_moves_with_odometry_where_a_view_tells_nothing():
    conversation = Relocalisation(CONFIG)
    conversation.observe(view(0, [loop(at(40.0))]))
    answer = conversation.observe(view(1, [rejected(at(300.0))]))
    assert answer.state is State.PLACED
    np.testing.assert_allclose(answer.poses[0].T_frame_view, along(40.0, 1), atol=1e-9)
    assert answer.poses[0].covariance[0, 0] > 0.01


def test_poses_that_fit_alike_are_several_until_a_view_refutes_one():
    conversation = Relocalisation(CONFIG)
    first = conversation.observe(view(0, [ambiguous(at(0.0), at(8.0), at(16.0))]))
    assert first.state is State.SEVERAL and len(first.poses) == 3
    assert first.none_of_them + sum(one.probability for one in first.poses) == pytest.approx(1.0)
    second = conversation.observe(
        view(1, [loop(along(8.0, 1)), rejected(along(0.0, 1)), rejected(along(16.0, 1))], [True] * 3)
    )
    assert second.state is State.PLACED
    np.testing.assert_allclose(second.poses[0].T_frame_view, along(8.0, 1), atol=1e-9)
    assert second.poses[0].views == 2


def test_two_accepted_pairs_at_two_places_are_never_one_answer():
    conversation = Relocalisation(CONFIG)
    answer = conversation.observe(view(0, [loop(at(0.0)), loop(at(50.0))]))
    assert answer.state is State.SEVERAL
    placed = Relocalisation(CONFIG)
    placed.observe(view(0, [loop(at(0.0))]))
    assert placed.observe(view(1, [loop(along(50.0, 1))])).state is State.SEVERAL


def test_a_pose_that_later_views_contradict_is_given_up():
    conversation = Relocalisation(CONFIG)
    conversation.observe(view(0, [loop(at(0.0))]))
    for step in range(1, 4):
        claims = [loop(along(50.0, step)), rejected(along(0.0, step))]
        answer = conversation.observe(view(step, claims, [True]))
    assert answer.state is State.PLACED
    np.testing.assert_allclose(answer.poses[0].T_frame_view, along(50.0, 3), atol=1e-9)


def test_outside_of_the_map_nothing_is_told_and_the_reason_says_so():
    conversation = Relocalisation(CONFIG)
    answers = [conversation.observe(view(step, [rejected(at(90.0 * step))])) for step in range(5)]
    assert {one.state for one in answers} == {State.UNKNOWN}
    assert answers[0].reason is UnknownReason.NOT_YET
    assert answers[-1].reason is UnknownReason.NOT_IN_MAP
    assert answers[-1].none_of_them == 1.0


def test_poses_that_are_less_probable_than_none_of_them_are_not_told():
    faint = [rejected(at(40.0 * n), 0.3, RejectionReason.LOW_SCORE) for n in range(6)]
    answer = Relocalisation(CONFIG).observe(view(0, faint))
    assert answer.state is State.UNKNOWN and answer.reason is UnknownReason.NOT_YET


def test_a_hall_that_repeats_everywhere_is_told_as_such():
    pairs = [ambiguous(*(at(8.0 * n + 2.0 * k) for n in range(8)), overlap=0.5) for k in range(5)]
    answer = Relocalisation(CONFIG).observe(view(0, pairs))
    assert answer.reason is UnknownReason.PLACES_REPEAT and answer.poses == ()


def test_a_view_without_enough_returns_changes_nothing():
    conversation = Relocalisation(CONFIG)
    conversation.observe(view(0, [ambiguous(at(0.0), at(8.0))]))
    before = conversation.state
    assert conversation.lost(5.0).reason is UnknownReason.TOO_FEW_RETURNS
    assert conversation.state == before


def test_standing_still_is_no_further_evidence():
    conversation = Relocalisation(CONFIG)
    still = view(0, [ambiguous(at(0.0), at(8.0), overlap=0.6), ambiguous(at(8.0), overlap=0.55)])
    first = conversation.observe(still)
    for _ in range(5):
        again = conversation.observe(still)
    assert [one.probability for one in again.poses] == pytest.approx([one.probability for one in first.poses])
    assert again.poses[0].views == 1


def test_an_accepted_pair_decides_an_ambiguous_one_of_the_same_view():
    claims = [loop(at(0.0)), ambiguous(at(8.0), at(0.3))]
    assert Relocalisation(CONFIG).observe(view(0, claims)).state is State.PLACED
    claims = [loop(at(0.0)), ambiguous(at(8.0), at(16.0))]
    assert Relocalisation(CONFIG).observe(view(0, claims)).state is State.SEVERAL


def test_the_first_accepted_pair_counts_in_full_though_the_robot_has_hardly_moved():
    conversation = Relocalisation(CONFIG)
    conversation.observe(view(0, [rejected(at(90.0))]))
    answer = conversation.observe(View(at(1.0), 1.0, [loop(at(5.0))], [HERE]))
    assert answer.state is State.PLACED


def test_a_doubted_pair_places_nobody():
    doubted = loop(at(0.0)).doubted(Doubt.BETTER_ALTERNATIVE, Grounds("another place explains more"))
    assert Relocalisation(CONFIG).observe(view(0, [doubted])).state is not State.PLACED


POSES = st.lists(st.integers(0, 20).map(lambda n: 8.0 * n), min_size=1, max_size=6, unique=True)
KINDS = st.sampled_from(["loop", "ambiguous", "rejected"])


def evidence(kind, x_m, step):
    make = {"loop": loop, "ambiguous": ambiguous, "rejected": rejected}[kind]
    return make(along(x_m, step))


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.lists(st.tuples(KINDS, st.integers(0, 12)), min_size=1, max_size=6), min_size=1, max_size=5),
    st.randoms(),
)
def test_the_order_of_equal_evidence_does_not_matter_and_probabilities_sum_up(steps, random):
    one, other = Relocalisation(CONFIG), Relocalisation(CONFIG)
    for step, said in enumerate(steps):
        claims = [evidence(kind, 8.0 * n, step) for kind, n in said]
        near = [True] * len(one.state.hypotheses)
        answer = one.observe(view(step, claims, near))
        shuffled = list(claims)
        random.shuffle(shuffled)
        same = other.observe(view(step, shuffled, near))
        assert answer.state is same.state and len(answer.poses) == len(same.poses)
        for left, right in zip(answer.poses, same.poses, strict=True):
            np.testing.assert_allclose(left.T_frame_view, right.T_frame_view)
            assert left.probability == pytest.approx(right.probability)
        total = answer.none_of_them + sum(pose.probability for pose in answer.poses)
        assert total <= 1.0 + 1e-9
        assert len(answer.poses) == 1 if answer.state is State.PLACED else True
        assert (answer.state is State.UNKNOWN) == (not answer.poses) == (answer.reason is not None)
        assert all(a.probability >= b.probability for a, b in pairwise(answer.poses))


@settings(deadline=None, max_examples=25)
@given(POSES, st.integers(1, 6), st.booleans())
def test_no_single_answer_while_a_rival_holds(starts, views, accepted):
    """Poses that every view bears out alike are never one answer, however far the robot drives."""
    conversation = Relocalisation(CONFIG)
    make = loop if accepted else ambiguous
    for step in range(views):
        claims = [make(along(x_m, step)) for x_m in starts]
        answer = conversation.observe(view(step, claims, [True] * len(conversation.state.hypotheses)))
        assert (answer.state is State.PLACED) == (len(starts) == 1 and accepted)


@settings(deadline=None, max_examples=20)
@given(st.lists(st.floats(0.0, 0.19), min_size=1, max_size=8))
def test_nothing_that_fits_is_unknown(overlaps):
    conversation = Relocalisation(CONFIG)
    for step, overlap in enumerate(overlaps):
        answer = conversation.observe(view(step, [rejected(along(0.0, step), overlap)]))
        assert answer.state is State.UNKNOWN


def test_a_frame_of_its_own_is_no_rival_but_two_loops_there_are():
    other = replace(HERE, frame="frame-2")
    claims = [loop(at(0.0)), ambiguous(at(7.0))]
    answer = Relocalisation(CONFIG).observe(View(at(0.0), 0.0, claims, [HERE, other]))
    assert answer.state is State.PLACED and answer.poses[0].frame == "frame-1"
