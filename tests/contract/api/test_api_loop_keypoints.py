"""What was compared for a loop closure: the keypoints of both submaps, on both transports."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.sdk.errors import DataLoss, NotFound
from tests.support.places import T_SUBMAP_LEVEL, a_place, in_place_of, places_of
from tests.support.service_world import cloud_points, pose

COUNT = 12


@pytest.fixture
def loop(client, session):
    """A loop that moves the query by 1 m along x, between two submaps whose places nobody can read yet."""
    for number, submap_id in enumerate("ab"):
        client.wait(client.post_submap(session, submap_id, cloud_points(4), pose(20.0 * number), 1_000 + number))
    operation = client.create_loop_closure(f"{session.name}/submaps/b", f"{session.name}/submaps/a")
    client.wait(operation)
    (found,) = client.loop_closures(session.name.partition("/sessions/")[0])
    np.testing.assert_allclose(found.T_match_query[:3, 3], [1.0, 0.0, 0.0])
    return found


def test_keypoints_that_look_alike_are_paired_and_those_that_the_pose_joins_are_told(client, service, loop):
    of_query = places_of(service, loop, COUNT, elsewhere=3)
    found = client.loop_keypoints(loop)
    assert (found.query.submap, found.match.submap) == (loop.query, loop.match)
    np.testing.assert_allclose(found.query.keypoints, of_query, atol=0.03)  # stored in tenths of a metre
    np.testing.assert_allclose(found.match.T_submap_level, T_SUBMAP_LEVEL, atol=1e-6)
    assert {tuple(pair) for pair in found.pairs} == {(k, k) for k in range(COUNT)}
    assert {int(query) for query, _ in found.pairs[found.agrees]} == set(range(COUNT - 3))


def test_keypoints_of_two_models_are_not_compared(client, service, loop):
    plan = np.zeros((2, 2))
    in_place_of(service, loop.query, a_place(plan))
    in_place_of(service, loop.match, a_place(plan, model="patches-2"))
    found = client.loop_keypoints(loop.name)
    assert len(found.query.keypoints) == 2 and len(found.pairs) == 0 and len(found.agrees) == 0


def test_a_place_that_cannot_be_read_is_data_loss_and_an_unknown_loop_is_not_found(client, loop):
    with pytest.raises(DataLoss):
        client.loop_keypoints(loop)
    with pytest.raises(NotFound):
        client.loop_keypoints(f"{loop.name}-x")
