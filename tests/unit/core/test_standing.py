"""What still stands after later drives, and what changed from drive to drive, in scenes known point by point."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.merge.evidence import ChangeKind
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.history import changes_over_time
from revisit.core.merge.standing import standing, still_standing
from revisit.core.merge.tiles import changes_in_tile, fuse_tile
from revisit.core.merge.visits import visits_of
from tests.support.walled_scenes import EPOCH_NS, FARTHER, WALL, of_wall, seen


def test_maps_of_one_drive_are_left_as_they_are():
    maps = [seen(1, WALL), seen(1, x_m=2.0)]
    assert all(one is other for one, other in zip(still_standing(maps), maps, strict=True))


def test_what_a_later_drive_looked_through_is_gone_and_all_else_stays():
    maps = [seen(1, WALL), seen(2)]
    first, second = standing(maps)
    assert not first[of_wall(maps[0])].any()
    assert first[~of_wall(maps[0])].all() and second.all()


def test_what_no_later_drive_could_see_stays():
    hidden = seen(2, (0.0, 4.0), behind=False)  # a wall stands before it, and of the houses nothing is seen
    far = seen(2, x_m=60.0)
    for later in (hidden, far):
        maps = [seen(1, WALL), later]
        assert standing(maps)[0].all()


def test_what_has_come_back_stands_and_what_is_seen_again_was_never_gone():
    maps = [seen(1, WALL), seen(2), seen(3, WALL)]
    assert all(its.all() for its in standing(maps))
    maps = [seen(1, WALL), seen(2, WALL), seen(3)]
    assert [its[of_wall(one)].mean() for one, its in zip(maps[:2], standing(maps)[:2], strict=True)] == [0.0, 0.0]


def test_up_to_the_day_before_it_went_it_stands():
    maps = [seen(1, WALL), seen(2, WALL), seen(3)]
    assert all(its.all() for its in standing(maps[:2]))


def test_few_points_that_were_looked_through_are_noise():
    first = seen(1)
    few = np.array([[0.0, 8.0, 0.3 * k - 1.2] for k in range(5)], np.float32)
    points = np.concatenate([first.neural_map.points.positions, few])
    normals = np.tile(np.float32([0.0, 0.0, 1.0]), (len(points), 1))
    known = NeuralPoints.remembered(points, normals, np.full(len(points), 3, np.int32), 3)
    noisy = PlacedMap(NeuralMap.of_planes(known, np.arange(3), ImplicitMapConfig()), np.eye(4), 1, EPOCH_NS)
    assert standing([noisy, seen(2)])[0].all()


def with_points(one, points):
    """The same submap, which saw these points (n, 3), too."""
    more = np.concatenate([one.neural_map.points.positions, np.asarray(points, np.float32)])
    normals = np.tile(np.float32([0.0, 0.0, 1.0]), (len(more), 1))
    known = NeuralPoints.remembered(more, normals, np.full(len(more), 3, np.int32), 3)
    its = NeuralMap.of_planes(known, np.arange(3), ImplicitMapConfig())
    return PlacedMap(its, one.T_map_submap, one.session, one.stamp_ns)


def above_wall(low_m, high_m):
    """Points (n, 3) above the wall from one height to another; from 1.5 m on no house is behind them."""
    x, z = np.meshgrid(np.arange(-1.2, 1.3, 0.2), np.arange(low_m, high_m, 0.2))
    return np.stack([WALL[0] + x.ravel(), np.full(x.size, WALL[1]), z.ravel()], axis=1)


def test_the_top_of_a_thing_that_has_gone_goes_with_it_though_rays_above_meet_nothing():
    top = above_wall(0.3, 2.3)
    first = with_points(seen(1, WALL), top)
    assert not standing([first, seen(2)])[0][-len(top) :].any()
    assert standing([first, with_points(seen(2), top)])[0][-len(top) :].all()  # a roof that is still there


def test_what_hangs_above_a_thing_that_has_gone_or_towers_above_it_stays():
    hanging, tower = above_wall(2.5, 3.0), above_wall(0.3, 7.0)
    for points, high in ((hanging, hanging), (tower, tower[tower[:, 2] > 5.0])):
        order = np.argsort(points[:, 2])
        first = with_points(seen(1, WALL), points[order])
        assert standing([first, seen(2)])[0][-len(high) :].all()


def test_the_tile_of_now_lacks_the_wall_and_that_of_ever_has_it():
    maps = [seen(1, WALL), seen(2)]
    undated = [PlacedMap(one.neural_map, one.T_map_submap) for one in maps]
    now, ever, alone = (fuse_tile(some, np.zeros(3)) for some in (maps, undated, undated[1:]))
    high = [int((tile.points.vertices[:, 2] > -1.0).sum()) for tile in (now, ever, alone)]
    assert high[0] == high[2] < high[1]
    of_one = fuse_tile(maps[:1], np.zeros(3))
    assert of_one.neural_map == fuse_tile(undated[:1], np.zeros(3)).neural_map


def test_changes_are_told_with_the_drive_that_found_them_and_when_it_was_otherwise():
    maps = [seen(1, WALL), seen(2, WALL), seen(3), seen(4, WALL)]
    gone, back = changes_over_time(maps)
    assert (gone.thing.kind, gone.session, back.thing.kind, back.session) == (
        ChangeKind.VANISHED,
        3,
        ChangeKind.BACK,
        4,
    )
    assert (gone.before_ns, gone.stamp_ns) == (maps[1].stamp_ns, maps[2].stamp_ns)
    assert (back.before_ns, back.stamp_ns) == (maps[2].stamp_ns, maps[3].stamp_ns)
    np.testing.assert_allclose(gone.thing.centre_m, (*WALL, -0.7), atol=0.3)
    np.testing.assert_allclose(gone.thing.extent_m, (2.7, 0.0, 1.8), atol=0.4)


def test_what_stands_elsewhere_has_moved_and_what_is_new_has_appeared():
    (moved,) = changes_over_time([seen(1, WALL), seen(2, FARTHER)])
    assert moved.thing.kind is ChangeKind.MOVED
    np.testing.assert_allclose(moved.moved_from_m[:2], WALL, atol=0.3)
    np.testing.assert_allclose(moved.thing.centre_m[:2], FARTHER, atol=0.3)
    (new,) = changes_over_time([seen(1), seen(2, WALL)])
    assert new.thing.kind is ChangeKind.APPEARED and new.moved_from_m is None
    assert changes_over_time([seen(1, WALL), seen(2, WALL)]) == []


def test_the_order_in_which_maps_are_given_plays_no_part():
    maps = [seen(1, WALL), seen(2, WALL), seen(3, FARTHER), seen(4, WALL)]
    assert changes_over_time(maps) == changes_over_time(maps[::-1])
    for its, other in zip(standing(maps), standing(maps[::-1])[::-1], strict=True):
        np.testing.assert_array_equal(its, other)


def test_a_change_belongs_to_the_tile_that_its_centre_lies_in():
    maps = [seen(1, WALL), seen(2)]
    (here,) = changes_in_tile(maps, np.array([10.0, 10.0, 0.0]))
    np.testing.assert_allclose(here.thing.centre_m, (*WALL, -0.7), atol=0.3)
    assert changes_in_tile(maps, np.array([10.0, 10.0 + 51.2, 0.0])) == []


def test_clocks_that_begin_anew_with_each_session_leave_the_order_to_their_numbers():
    maps = [PlacedMap(one.neural_map, one.T_map_submap, one.session, 7) for one in (seen(1), seen(2))]
    assert [one.session for one in visits_of(maps)] == [1, 2]
    dated = [seen(1, day=9), seen(2, day=4)]
    assert [one.session for one in visits_of(dated)] == [2, 1]


@pytest.mark.parametrize(("minutes", "visits"), [(5, 1), (15, 2)])
def test_a_drive_that_pauses_is_two_visits(minutes, visits):
    first = seen(1)
    again = PlacedMap(first.neural_map, first.T_map_submap, 1, first.stamp_ns + minutes * 60 * 10**9)
    assert len(visits_of([first, again])) == visits


def at(one, stamp_ns):
    """The same submap, taken at another time."""
    return PlacedMap(one.neural_map, one.T_map_submap, one.session, stamp_ns)


def test_clocks_without_a_date_leave_the_order_to_the_numbers_also_where_two_drives_passed_at_different_times():
    maps = [at(seen(1, WALL), 100 * 10**9), at(seen(2), 10 * 10**9)]  # the second drive came by sooner after its start
    assert [one.session for one in visits_of(maps)] == [1, 2]
    assert not standing(maps)[0][of_wall(maps[0])].any()
    assert [one.thing.kind for one in changes_over_time(maps)] == [ChangeKind.VANISHED]


def test_what_a_robot_saw_before_a_thing_was_there_says_nothing_against_it():
    minutes = [EPOCH_NS + 60 * 10**9 * minute for minute in (0, 5, 9, 10)]
    before, ended = at(seen(2), minutes[0]), at(seen(2, x_m=60.0), minutes[3])  # one drive: it passed, and went on
    parked = at(seen(1, WALL), minutes[2])  # beside it, another robot's
    maps = [before, parked, ended]
    assert [one.session for one in visits_of(maps)] == [1, 2]
    assert standing(maps)[1].all()
    assert ChangeKind.VANISHED not in [one.thing.kind for one in changes_over_time(maps)]
    gone = at(seen(2), minutes[3])
    assert not standing([before, parked, gone])[1][of_wall(parked)].any()


def test_what_was_seen_at_one_time_in_a_drive_is_dated_by_its_submap():
    first = [at(seen(1, WALL), EPOCH_NS), at(seen(1, x_m=60.0), EPOCH_NS + 300 * 10**9)]
    (gone,) = changes_over_time([*first, seen(2)])
    assert gone.before_ns == EPOCH_NS
