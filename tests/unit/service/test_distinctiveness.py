"""How many other spots a submap would pass at is told with its loops."""

from __future__ import annotations

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.distinctiveness import distinctiveness, with_distinctiveness
from revisit.service.application.recognise.loops_beside import Beside
from tests.support.records import a_submap

QUERY = a_submap("q", 100, number=500, session_number=2)


def candidate(x_m: float, claims_m: list[float], reason: str | None = None, session: int = 1) -> Beside:
    """A submap at `x_m` on its drive, and where on it the query would stand by each of its poses."""
    ordinal = int(x_m // 10)
    match = a_submap(
        f"m{ordinal}", ordinal, session_number=session, T_odom_submap=pose_row(se3.from_yaw(0.0, (x_m, 0, 0)))
    )
    poses = [se3.from_yaw(0.0, (claim - x_m, 0.0, 0.0)) for claim in claims_m]
    rivals = [{"overlap": 0.5, "T_match_query": pose.tolist()} for pose in poses[1:]]
    T = poses[0] if poses else None
    return Beside(QUERY, match, 0.9, LoopVerdict(reason is None, reason, 0.8, T, {"measurement": {"rivals": rivals}}))


def test_submaps_beside_each_other_that_put_a_query_at_one_spot_are_one_spot() -> None:
    judged = [candidate(20.0, [24.0]), candidate(30.0, [24.5]), candidate(80.0, [], "LOW_OVERLAP")]
    assert distinctiveness(judged[0], judged, 10.0) == {"compared": 3, "passing": 2, "other_spots": 0}


def test_every_other_house_of_a_row_is_another_spot() -> None:
    judged = [
        candidate(20.0, [24.0, 34.0, 14.0], "AMBIGUOUS"),
        candidate(30.0, [34.0, 44.0, 24.0], "AMBIGUOUS"),
        candidate(40.0, [54.0], session=3),
    ]
    told = distinctiveness(judged[0], judged, 10.0)
    assert told == {"compared": 3, "passing": 3, "other_spots": 3}
    assert distinctiveness(judged[2], judged, 10.0)["other_spots"] == 0


def test_what_odometry_may_have_drifted_on_a_long_way_is_no_other_spot() -> None:
    judged = [candidate(20.0, [24.0]), candidate(2020.0, [33.0])]
    assert distinctiveness(judged[0], judged, 10.0)["other_spots"] == 0
    assert distinctiveness(judged[0], judged, 1.0)["other_spots"] == 1


def test_a_rejected_candidate_keeps_its_evidence() -> None:
    rejected, accepted = candidate(80.0, [], "LOW_OVERLAP"), candidate(20.0, [24.0])
    assert with_distinctiveness(rejected, [rejected, accepted], 10.0) is rejected.verdict
    verdict = with_distinctiveness(accepted, [rejected, accepted], 10.0)
    assert verdict.evidence["distinctiveness"]["compared"] == 2
    assert np.array_equal(verdict.evidence["measurement"]["rivals"], [])
