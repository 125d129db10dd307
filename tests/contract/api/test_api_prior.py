"""A prior position is in the odometry frame of one session: which one is said, or there is only one."""

from __future__ import annotations

import pytest

from revisit.sdk.errors import InvalidArgument, NotFound
from tests.support.service_world import cloud_points, pose

NEAR = {"prior_position_m": (3.0, 0.0, 0.0), "radius_m": 1.0}


@pytest.fixture
def two_sessions(client, session, town):
    """A submap of one place in each of two sessions, 3 m and 50 m from the origins of their frames."""
    tuesday = client.create_session(town, "tuesday")
    for where, x_m in ((session, 3.0), (tuesday, 50.0)):
        client.wait(client.post_submap(where, "s", cloud_points(1), pose(x_m), 1))
    return session, tuesday


def test_a_prior_with_its_session_finds_what_is_near_in_that_frame(client, town, two_sessions):
    monday, tuesday = two_sessions
    assert client.localize(town, cloud_points(1), **NEAR, only_session=monday).session == monday.name
    assert client.localize(town, cloud_points(1), **NEAR, only_session="tuesday").best is None
    assert client.localize(town, cloud_points(1), only_session=tuesday).session == tuesday.name


def test_a_prior_without_a_session_is_refused_where_there_are_several(client, town, two_sessions):
    with pytest.raises(InvalidArgument, match="only_session") as refused:
        client.localize(town, cloud_points(1), **NEAR)
    assert refused.value.field == "only_session"
    with pytest.raises(InvalidArgument, match="only_session"):
        client.search(town, points=cloud_points(1), **NEAR)


def test_a_map_of_one_session_has_one_frame(client, town, session):
    client.wait(client.post_submap(session, "s", cloud_points(1), pose(3.0), 1))
    assert client.localize(town, cloud_points(1), **NEAR).session == session.name


def test_a_session_that_does_not_exist_is_not_found(client, town, session):
    with pytest.raises(NotFound):
        client.localize(town, cloud_points(1), only_session="never")
