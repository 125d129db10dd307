"""A loop that others have decided falls with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.acceptance import Doubt, LoopClaim, Station, Support
from revisit.core.acceptance.support import with_own_odometry, with_support, without_lost_support
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification import InitialPose, PairVerdict
from tests.support.claims import STRIDE_M, WORDS, along_x, at, doubted, pair
from tests.support.verdicts import rejected, verified

CONFIG = VerificationConfig()
PERIOD = along_x(16.0)


def loop(place: int, *, pose: np.ndarray = along_x(0.0)) -> LoopClaim:
    """Two drives in one frame meet at `place`: a loop of what both saw there."""
    return pair(at(STRIDE_M * place, 2), at(STRIDE_M * place, 1), [pose], overlap=0.5)


def withdrawn(place: int, **told) -> LoopClaim:
    return doubted(loop(place, **told), Doubt.PAIRWISE_INCONSISTENT)


DECIDED = replace(loop(3), support=Support(2, 2, 15.0, (PERIOD,)))
STANDING = [loop(0), loop(1)]
FALLEN = [withdrawn(0), withdrawn(1)]


def lost(claims: list[LoopClaim]) -> dict[int, LoopClaim]:
    return without_lost_support(claims, CONFIG, STRIDE_M)


def test_a_loop_whose_anchors_were_contradicted_is_ambiguous_again() -> None:
    changed = lost([*FALLEN, DECIDED])
    assert changed.keys() == {2} and (changed[2].accepted, changed[2].reason) == (False, "AMBIGUOUS")
    assert changed[2].support is None and changed[2].doubts[Doubt.SUPPORT_LOST].words
    rivals = changed[2].measurement.rivals
    assert [(one.overlap, one.T_match_query.tolist()) for one in rivals] == [(0.5, PERIOD.tolist())]
    assert len(changed[2].hypotheses) == 2


def test_a_loop_keeps_its_support_where_enough_anchors_are_left() -> None:
    assert lost([*STANDING, DECIDED]) == {}
    assert lost([*STANDING, loop(4), withdrawn(2), DECIDED]) == {}


def test_a_loop_does_not_fall_with_one_that_had_said_something_else() -> None:
    assert lost([withdrawn(0, pose=PERIOD), DECIDED]) == {}


def test_what_a_person_has_made_stays_and_what_stands_by_itself_needs_no_support() -> None:
    assert lost([*FALLEN, loop(3)]) == {}
    assert lost([*FALLEN, replace(DECIDED, by_hand=True)]) == {}


def test_loops_that_stand_out_from_no_other_place_support_none() -> None:
    asked = pair(at(15.0, 2), at(15.0, 1), [along_x(0.0), PERIOD], "AMBIGUOUS", overlap=0.5)
    by_themselves = [loop(place) for place in range(3)]
    alike = [doubted(one, Doubt.PERCEPTUAL_ALIAS) for one in by_themselves]

    def near(_row: int, _pose: InitialPose) -> PairVerdict:
        return verified(along_x(0.0))

    assert with_support([*alike, asked], CONFIG, STRIDE_M, near) == {}
    decided = with_support([*by_themselves, asked], CONFIG, STRIDE_M, near)
    assert decided[3].accepted and decided[3].support is not None and decided[3].support.anchors == 3


def test_a_loop_with_support_keeps_the_doubts_that_support_overrules_and_loses_those_asked_anew() -> None:
    asked = pair(at(15.0, 2), at(15.0, 1), [along_x(0.0)], overlap=0.5)
    asked = doubted(asked, Doubt.PAIRWISE_INCONSISTENT, Doubt.SUPPORT_LOST)

    def near(_row: int, pose: InitialPose) -> PairVerdict:
        return verified(pose.T_match_query)

    decided = with_support([*[loop(place) for place in range(3)], asked], CONFIG, STRIDE_M, near)[3]
    assert decided.accepted and decided.doubts.keys() == {Doubt.PAIRWISE_INCONSISTENT}


def test_anchors_that_side_with_a_doubted_pose_say_so_and_not_that_no_other_pose_fits():
    alone, among = (Support(0, 0, 0.0, poses, on_earth=True) for poses in ((), (np.eye(4),)))
    assert "loops beside it had doubted it" in alone.words and "fit as well; anchors beside both submaps" in among.words


def returned(way_m: float, poses: list[np.ndarray], **told) -> LoopClaim:
    """A drive comes back, after `way_m`, to where it was: `poses` fit, of which odometry says the one at 1 m."""
    query = Station(2, int(way_m // STRIDE_M), along_x(1.0))
    return pair(query, Station(2, 0, along_x(0.0)), poses, "AMBIGUOUS", overlap=0.5, **told)


def by_odometry(*claims: LoopClaim, verdict=None) -> dict[int, LoopClaim]:
    def near(_row: int, pose: InitialPose) -> PairVerdict:
        return verified(pose.T_match_query) if verdict is None else verdict

    return with_own_odometry(claims, CONFIG, STRIDE_M, near)


TURNED = se3.from_yaw(np.pi, (1.0, 0.0, 0.0))


@pytest.mark.parametrize("poses", [[along_x(1.2), TURNED], [TURNED, along_x(1.2)], [along_x(7.0), along_x(1.2)]])
def test_the_odometry_of_a_drive_that_comes_back_soon_chooses_among_its_poses(poses) -> None:
    claim = by_odometry(returned(40.0, poses))[0]
    assert claim.accepted_by_itself and np.allclose(claim.T_match_query, along_x(1.2))
    assert claim.support is not None and claim.support.own_odometry and claim.support.along_m == 40.0
    assert "odometry since then, over at least 40 m" in claim.support.words
    assert not replace(claim, doubts={Doubt.PAIRWISE_INCONSISTENT: WORDS}).accepted


@pytest.mark.parametrize(
    "claim",
    [
        returned(70.0, [along_x(1.0), TURNED]),
        returned(40.0, [along_x(4.0), TURNED]),
        returned(40.0, [along_x(1.0), along_x(2.3), TURNED]),
        returned(40.0, [along_x(1.0), along_x(2.5), TURNED]),
        replace(returned(40.0, [along_x(1.0), TURNED]), query=at(200.0, 3)),
        doubted(returned(40.0, [along_x(1.0), TURNED]), Doubt.LOW_CONSISTENT_SHARE),
        replace(returned(40.0, [along_x(1.0), TURNED]), by_hand=True),
    ],
    ids=["a long way", "none agrees", "two agree", "two too near", "two drives", "doubted", "by hand"],
)
def test_odometry_chooses_none_where_it_is_unsure_or_not_alone(claim) -> None:
    assert by_odometry(claim) == {}


def test_what_odometry_chooses_must_pass_there_and_stay_there() -> None:
    asked = returned(40.0, [along_x(1.0), TURNED])
    assert by_odometry(asked, verdict=rejected("LOW_SCORE", along_x(1.0))) == {}
    assert by_odometry(asked, verdict=verified(along_x(2.0))) == {}
