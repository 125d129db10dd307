"""Which sightings of tags count, and the reason why others do not."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchors import AnchorReason, AnchorState
from revisit.core.pose_graph.graph import Node
from revisit.core.pose_graph.tags import MOST_OPEN, TaggedDrive, TagSighting, doubled_tags, judged_sightings

POSES = np.stack([se3.from_yaw(0.0, (5.0 * n, 0.0, 0.0)) for n in range(20)])
DRIVES = {"a": POSES, "b": POSES, "c": POSES}


def sighting(session, ordinal, tag, place, name=None):
    point = se3.apply(se3.inverse(POSES[ordinal]), np.array([place], dtype=np.float64))[0]
    return TagSighting(name or f"{session}{ordinal}{tag}{place}", Node(session, ordinal), tag, point, 0.05)


def judged(*sightings, components=(("a", "b", "c"),)):
    return judged_sightings(DRIVES, DRIVES, components, sightings)


def reasons(*sightings, **more):
    return [one.reason for one in judged(*sightings, **more)]


HERE, THERE = (12.0, 2.0, 0.5), (62.0, 2.0, 0.5)


def test_a_tag_that_two_passes_have_at_one_place_is_in_the_map():
    one, other = judged(sighting("a", 2, "7", HERE), sighting("b", 2, "7", (12.2, 2.0, 0.5)))
    assert (one.state, one.reason) == (other.state, other.reason) == (AnchorState.IN_MAP, None)
    np.testing.assert_allclose(one.residual_m, (0.2, 0.0, 0.0), atol=1e-9)


def test_sightings_of_one_pass_are_one_witness():
    assert reasons(sighting("a", 2, "7", HERE), sighting("a", 3, "7", HERE)) == [AnchorReason.SEEN_ONCE] * 2


def test_a_tag_in_two_frames_that_no_loop_joins():
    found = judged(sighting("a", 2, "7", HERE), sighting("b", 2, "7", HERE), components=(("a",), ("b", "c")))
    assert [one.reason for one in found] == [AnchorReason.NOT_JOINED] * 2
    assert {one.state for one in found} == {AnchorState.NOT_ALIGNED} and np.isnan(found[0].residual_m).all()


def test_of_a_tag_that_was_moved_the_odd_pass_is_set_aside_and_both_where_there_are_but_two():
    a, b, c = (sighting(name, 2, "7", place) for name, place in (("a", HERE), ("b", HERE), ("c", (16.0, 2.0, 0.5))))
    assert reasons(a, b, c) == [None, None, AnchorReason.MOVED]
    assert reasons(a, c) == [AnchorReason.MOVED] * 2
    assert judged(a, c)[0].state is AnchorState.SET_ASIDE


def test_an_id_at_two_places_of_one_drive_counts_in_none():
    found = reasons(sighting("a", 2, "7", HERE), sighting("a", 12, "7", THERE), sighting("b", 2, "7", HERE))
    assert found == [AnchorReason.TWO_PLACES] * 3


def test_a_drive_that_comes_back_after_it_has_drifted_sees_one_tag_still():
    there_and_back = np.concatenate([POSES, POSES[::-1]])
    first, last = sighting("a", 2, "7", HERE), sighting("a", 2, "7", (12.0, 4.5, 0.5))
    drive = TaggedDrive(there_and_back, [first, replace(last, name="again", node=Node("a", 37))])
    assert len(drive.passes) == 2 and doubled_tags([drive]) == frozenset()


@pytest.mark.parametrize("place", [HERE, THERE], ids=["for the tag there", "for one elsewhere"])
def test_a_tag_that_is_read_for_another_once_of_four_times_is_misread(place):
    """Of the tag seen four times at one place; the id that is read is that of a tag seen four times at the other."""
    right = [sighting("a", n, "7", HERE, f"r{n}") for n in (1, 2, 3, 3)]
    right = [replace(one, name=f"{one.name}-{n}") for n, one in enumerate(right)]
    others = [replace(sighting("a", n, "9", THERE), name=f"o{n}") for n in (11, 12, 13)]
    wrong = sighting("a", 2 if place is HERE else 12, "9" if place is HERE else "7", place, "wrong")
    found = reasons(*right, *others, wrong)
    assert found[-1] is AnchorReason.MISREAD and AnchorReason.MISREAD not in found[:-1]
    assert AnchorReason.TWO_PLACES not in found


@pytest.mark.parametrize(("off_m", "reasons_of_it"), [(9.0, set()), (25.0, {"7"})], ids=["drift", "another tag"])
def test_odometry_that_drifts_by_a_twentieth_of_its_way_makes_no_tag_two(off_m, reasons_of_it):
    way_back = np.concatenate([POSES, POSES[::-1]])
    first = sighting("a", 2, "7", HERE)
    last = replace(sighting("a", 2, "7", (12.0, 2.0 + off_m, 0.5)), name="again", node=Node("a", 37))
    assert TaggedDrive(way_back, [first, last]).doubled == reasons_of_it


def test_a_tag_that_a_fleet_passes_often_is_in_the_map_however_the_map_scatters():
    """Four hundred passes: each is held against MOST_HELD of them."""
    random = np.random.default_rng(4)
    passes = [
        replace(sighting("a", 2, "7", HERE + 0.35 * random.normal(size=3)), name=f"{n}", node=Node(f"{n}", 2))
        for n in range(400)
    ]
    drives = {one.node.session: POSES for one in passes}
    found = judged_sightings(drives, drives, [tuple(drives)], passes)
    assert np.mean([one.state is AnchorState.IN_MAP for one in found]) > 0.95


def test_a_tag_at_a_thousand_spots_takes_a_bounded_time_and_memory_for_each(monkeypatch):
    asked = []
    monkeypatch.setattr(TaggedDrive, "_is_of_pass", lambda self, row, group: bool(asked.append(row)))
    some = [sighting("a", 2, "7", (12.0 + 30.0 * n, 2.0, 0.5), f"{n}") for n in range(1000)]
    tracemalloc.start()
    try:
        found = judged(*some)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert {one.reason for one in found} == {AnchorReason.TWO_PLACES}
    assert len(asked) <= MOST_OPEN * len(some) and peak_bytes < 20e6
