"""How many other spots a submap would pass at is told with its loops."""

from __future__ import annotations

from revisit.core.acceptance import Distinctiveness, LoopClaim
from revisit.core.acceptance.distinctiveness import with_distinctiveness
from tests.support.claims import along_x, at, pair

QUERY = at(500.0, 2)


def candidate(x_m: float, claims_m: list[float], reason: str | None = None, drive: int = 1) -> LoopClaim:
    """A submap at `x_m` on its drive, and where on it the query would stand by each of its poses."""
    return pair(QUERY, at(x_m, drive, 10.0), [along_x(claim - x_m) for claim in claims_m], reason, 0.8)


def told(claims: list[LoopClaim], stride_m: float = 10.0) -> list[Distinctiveness | None]:
    return [one.distinctiveness for one in with_distinctiveness(claims, stride_m)]


def test_submaps_beside_each_other_that_put_a_query_at_one_spot_are_one_spot() -> None:
    judged = [candidate(20.0, [24.0]), candidate(30.0, [24.5]), candidate(80.0, [], "LOW_OVERLAP")]
    assert told(judged)[0] == Distinctiveness(compared=3, passing=2, other_spots=0)


def test_every_other_house_of_a_row_is_another_spot() -> None:
    judged = [
        candidate(20.0, [24.0, 34.0, 14.0], "AMBIGUOUS"),
        candidate(30.0, [34.0, 44.0, 24.0], "AMBIGUOUS"),
        candidate(40.0, [54.0], drive=3),
    ]
    assert told(judged)[0] == Distinctiveness(compared=3, passing=3, other_spots=3)
    assert told(judged)[2] == Distinctiveness(3, 3, 0)


def test_what_odometry_may_have_drifted_on_a_long_way_is_no_other_spot() -> None:
    judged = [candidate(20.0, [24.0]), candidate(2020.0, [33.0])]
    assert told(judged)[0] == Distinctiveness(2, 2, 0)
    assert told(judged, 1.0)[0] == Distinctiveness(2, 2, 1)


def test_a_rejected_candidate_is_left_as_it_is() -> None:
    rejected, accepted = candidate(80.0, [], "LOW_OVERLAP"), candidate(20.0, [24.0])
    first, second = with_distinctiveness([rejected, accepted], 10.0)
    assert first is rejected and second.distinctiveness == Distinctiveness(2, 1, 0)
