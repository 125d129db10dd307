"""Two visits to the same spot of a lattice, a period apart: the same cubes were seen and kept, and no pose is surer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.geometry import se3
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pair_verdict import Authority, InitialPose
from revisit.core.pipeline import describe, verify
from revisit.core.place import Place
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.verification import RejectedLoop, RejectionReason, VerifiedLoop
from revisit.core.verification.oriented_points import OrientedPoints, shared_shares
from revisit.core.verification.overlap import overlap_beside
from tests.support.block_worlds import STEP_M, along, seen, storey

CONFIG = PipelineConfig()
PERIOD_M = 8.0


def place_from(start_m: float, seed: int) -> Place:
    """What a drive of 5 m between two rows of pillars sees."""
    poses = along((start_m, 0.5 * PERIOD_M), (start_m + 4 * STEP_M + 0.1, 0.5 * PERIOD_M))
    scans = [Scan.validated(*scan, stamp) for stamp, scan in enumerate(seen(storey(PERIOD_M), poses, seed))]
    return describe(Submap.from_scans(scans, CONFIG.submap), load_packaged_models(), CONFIG).place


@pytest.fixture(scope="module")
def bays() -> tuple[Place, Place]:
    return place_from(-9.0, 1), place_from(-9.0 + PERIOD_M, 2)


def test_a_pair_from_the_same_spot_of_two_bays_is_ambiguous(bays) -> None:
    match, query = bays
    verdict = verify(query, match, 0.9, CONFIG.verification)
    assert isinstance(verdict, RejectedLoop)
    assert verdict.reason is RejectionReason.AMBIGUOUS
    assert np.linalg.norm(verdict.measurement.T_match_query[:3, 3]) < 0.1  # the truth is 8 m off
    assert all(rival.overlap < 0.85 * verdict.measurement.overlap for rival in verdict.measurement.rivals)


def test_a_start_by_hand_a_bay_off_is_ambiguous_where_one_that_decides_would_be_accepted(bays) -> None:
    match, query = bays
    T_match_query = se3.from_yaw(0.02, (0.3, -0.2, 0.1))
    by_hand, decides = (
        verify(query, match, 0.9, CONFIG.verification, InitialPose(T_match_query, authority))
        for authority in (Authority.COMPETES, Authority.DECIDES)
    )
    assert isinstance(by_hand, RejectedLoop) and by_hand.reason is RejectionReason.AMBIGUOUS
    assert np.linalg.norm(by_hand.measurement.T_match_query[:3, 3]) < 0.1  # where it was put; the truth is 8 m off
    assert isinstance(decides, VerifiedLoop)


@pytest.mark.parametrize("rule", [{"rival_repeats": 9.0}, {"rival_repeats_share": 9.0}])
def test_it_takes_a_pose_that_explains_enough_and_a_step_by_which_both_places_repeat(bays, rule) -> None:
    match, query = bays
    verdict = verify(query, match, 0.9, replace(CONFIG.verification, **rule))
    assert isinstance(verdict, VerifiedLoop)


def wall(kept: np.ndarray) -> OrientedPoints:
    """A wall at y = 0.4 m with a point in the middle of each of the cubes `kept` (rows, columns)."""
    z, x = np.nonzero(kept)
    points = np.c_[0.8 * x + 0.3, np.full(len(x), 0.3), 0.8 * z + 0.3]
    return OrientedPoints(points, np.tile((0.0, 1.0, 0.0), (len(x), 1)), len(x))


def test_points_in_other_cubes_tell_the_same_whichever_cubes_were_kept() -> None:
    rng, rules = np.random.default_rng(2), VerificationConfig()
    first, second = (rng.random((12, 60)) < 0.3 for _ in range(2))
    alike, apart = (wall(first), wall(first)), (wall(first), wall(second))
    touching = [shared_shares(*pair, np.zeros((1, 3)), rules)[0] for pair in (alike, apart)]
    beside = [overlap_beside(np.eye(4), *pair, rules) for pair in (alike, apart)]
    assert touching[0] == 1.0 > touching[1] + 0.1
    assert abs(beside[0] - beside[1]) < 0.05
    assert beside[1] > 0.3


def test_points_in_other_cubes_overlap_the_same_in_either_direction() -> None:
    query, match = (wall(np.random.default_rng(seed).random((10, 40)) < 0.5) for seed in (4, 5))
    T_match_query = se3.from_yaw(0.02, (0.5, 0.01, 0.2))
    there = overlap_beside(T_match_query, query, match, VerificationConfig())
    assert there == pytest.approx(overlap_beside(se3.inverse(T_match_query), match, query, VerificationConfig()))
