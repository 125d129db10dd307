"""Tags of unknown place choose among the poses of a pair, and refute loops; misread, moved and doubled ones do not.

Simulated: two drives along one street where poses 3 m apart fit equally, with drift, and a tag every 15 to 20 m.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.anchors_for_loops import AnchorsForLoops, OpenPair
from revisit.core.pose_graph.graph import LoopEdge, Node
from revisit.core.pose_graph.tags import TagSighting
from revisit.core.pose_graph.tags_between import TagsBetween, refuted_by_tags

STEP_M, SUBMAPS, PERIOD_M, SIGMA_M = 5.0, 20, 3.0, 0.04
TAGS = {f"t{n}": np.array([x, (-1) ** n * 2.5, 0.3]) for n, x in enumerate((4.0, 21.0, 37.0, 55.0, 72.0, 90.0))}
T_A_B = se3.from_yaw(2.0, (7.0, -3.0, 0.5))
TRUE = {
    "a": np.stack([se3.from_yaw(0.0, (STEP_M * n, 0.0, 0.0)) for n in range(SUBMAPS)]),
    "b": np.stack([se3.from_yaw(np.pi, (STEP_M * n, 0.8, 0.0)) for n in reversed(range(SUBMAPS))]),
}


def driven(true, seed):
    """The drive (n, 4, 4) as its odometry has it, from anywhere: lengths are off by 0.4 %, headings walk."""
    random, found = np.random.default_rng(seed), [se3.inverse(T_A_B) @ true[0]]
    for first, second in itertools.pairwise(true):
        step = se3.inverse(first) @ second
        step[:3, 3] *= 1.004
        found.append(found[-1] @ step @ se3.from_yaw(np.radians(0.1) * random.normal()))
    return np.stack(found)


DRIVES = {name: driven(true, seed) for seed, (name, true) in enumerate(TRUE.items())}


def seen(session, tags=None, each=2):
    """Sightings of each tag by the submaps nearest to it."""
    random, found = np.random.default_rng(7 + ord(session)), []
    for tag, place in (TAGS if tags is None else tags).items():
        off_m = np.linalg.norm(TRUE[session][:, :3, 3] - place, axis=1)
        for ordinal in np.argsort(off_m)[:each]:
            point = se3.apply(se3.inverse(TRUE[session][ordinal]), place[None])[0] + SIGMA_M * random.normal(size=3)
            found.append(TagSighting(f"{session}:{len(found)}", Node(session, int(ordinal)), tag, point, SIGMA_M))
    return found


def pairs(shifts=(1, 0, -1), ordinals=range(SUBMAPS)):
    """Pairs beside each other, whose poses are off by periods; the true one is where `shifts` is 0."""
    found = []
    for n in ordinals:
        true = se3.inverse(TRUE["a"][n]) @ TRUE["b"][SUBMAPS - 1 - n]
        poses = tuple(se3.from_yaw(0.0, (PERIOD_M * k, 0.0, 0.0)) @ true for k in shifts)
        found.append(OpenPair(f"{n}", Node("a", n), Node("b", SUBMAPS - 1 - n), poses))
    return found


def chosen(sightings, some=None, anchors=()):
    return AnchorsForLoops(DRIVES, anchors, sightings).chosen(pairs() if some is None else some)


def with_tag(sightings, row, tag):
    return [replace(one, tag=tag) if n == row else one for n, one in enumerate(sightings)]


def moved(by, *names):
    return {tag: place + by if tag in names else place for tag, place in TAGS.items()}


A, B = seen("a"), seen("b")


def test_tags_that_both_drives_saw_choose_the_true_pose():
    found = chosen([*A, *B])
    assert len(found) >= 17 and set(found.values()) == {1}


def test_the_tags_that_agree_are_named():
    asked, (pair,) = AnchorsForLoops(DRIVES, [], [*A, *B]), pairs(ordinals=[9])
    assert {"t2", "t3"} <= {*asked.tags(pair, 1)} and asked.tags(pair, 0) == ()


@pytest.mark.parametrize("tags", [["t2"], []], ids=["one tag", "none"])
def test_one_tag_alone_chooses_nothing(tags):
    few = {tag: TAGS[tag] for tag in tags}
    assert chosen([*A, *seen("b", few)]) == {}


def test_two_tags_choose_where_they_are_near():
    two = {tag: TAGS[tag] for tag in ("t2", "t3")}
    found = chosen([*A, *seen("b", two)])
    assert len(found) >= 5 and set(found.values()) == {1}


def test_other_tags_of_a_twin_choose_nothing():
    assert chosen([*A, *seen("b", {f"other-{tag}": place for tag, place in TAGS.items()})]) == {}


@pytest.mark.parametrize("by", [(PERIOD_M, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 0.0, 3.2)], ids=["period", "far", "up"])
def test_a_tag_that_was_moved_between_the_drives_is_outvoted(by):
    found = chosen([*A, *seen("b", moved(by, "t2"))])
    assert len(found) >= 10 and set(found.values()) == {1}


def test_tags_of_which_as_many_were_moved_as_not_choose_nothing_wrong():
    found = chosen([*A, *seen("b", moved((PERIOD_M, 0.0, 0.0), "t0", "t2", "t4"))])
    assert set(found.values()) <= {1}


def test_a_misread_id_chooses_nothing_wrong_and_takes_little():
    for row in range(0, len(B), 3):
        found = chosen([*A, *with_tag(B, row, "t5" if B[row].tag != "t5" else "t0")])
        assert len(found) >= 10 and set(found.values()) == {1}


def test_a_tag_that_hangs_twice_says_nothing():
    """Had both drives seen one of both alone, it would put them a street apart."""
    twice = {**TAGS, "t1": TAGS["t4"] + (0.0, 0.0, 0.5)}
    here = [*seen("a"), *(replace(one, name=f"{one.name}'") for one in seen("a", {"t1": twice["t1"]}))]
    found = chosen([*here, *seen("b", twice)])
    assert len(found) >= 10 and set(found.values()) == {1}
    asked = TagsBetween(DRIVES, [*here, *B])
    put = asked.put(Node("a", 5), Node("b", SUBMAPS - 6))
    assert put is not None and "t1" not in put.tags


def test_an_id_that_one_drive_of_a_fleet_misreads_counts_in_the_others():
    """Each sighting alone is a pass of its own, so that none is outnumbered."""
    once = {name: seen(name, each=1) for name in "ab"}
    fleet = {f"c{n}": DRIVES["a"] for n in range(11)}
    theirs = [
        replace(one, name=f"{name}{one.name}", node=Node(name, one.node.ordinal)) for name in fleet for one in once["a"]
    ]
    wrong = replace(theirs[0], name="wrong", tag=once["a"][-1].tag)
    asked = TagsBetween({**DRIVES, **fleet}, [*once["a"], *once["b"], *theirs, wrong])
    put = asked.put(Node("a", 15), Node("b", SUBMAPS - 16))
    assert put is not None and "t5" in put.tags
    put = asked.put(Node("c0", 15), Node("b", SUBMAPS - 16))
    assert put is None or "t5" not in put.tags


def test_places_on_earth_and_tags_that_choose_different_poses_choose_none():
    fixes = []
    for session in "ab":
        for n, T in enumerate(TRUE[session]):
            place = T[:3, 3] + (PERIOD_M * (session == "b"), 0.0, 0.0)
            fixes.append(Anchor(f"{session}{n}", Node(session, n), np.zeros(3), place, 0.02**2 * np.eye(3)))
    assert set(chosen([], anchors=fixes).values()) == {0}
    assert chosen([*A, *B], anchors=fixes) == {}


def test_passes_of_one_drive_are_two_witnesses():
    """A drive that turns round: its second half sees the tags of the first."""
    both = np.concatenate([DRIVES["a"], _followed(DRIVES["a"][-1])])
    again = [replace(one, name=f"{one.name}'", node=Node("a", SUBMAPS + one.node.ordinal)) for one in B]
    some = [
        OpenPair(one.name, one.match, Node("a", SUBMAPS + one.query.ordinal), one.poses)
        for one in pairs(ordinals=range(4, 16))
    ]
    found = AnchorsForLoops({"a": both}, [], [*A, *again]).chosen(some)
    assert len(found) >= 6 and set(found.values()) == {1}


@pytest.mark.parametrize("slipped", [3, SUBMAPS - 3])
def test_odometry_that_slips_by_a_period_chooses_nothing_wrong_and_refutes_no_true_loop(slipped):
    """Of the submaps beyond the slip fewer tags hang on their side of it than on the other."""
    period_m = 6.0
    slip = se3.from_yaw(0.0, tuple(period_m * DRIVES["b"][slipped][:3, 0]))
    drives = {**DRIVES, "b": np.concatenate([DRIVES["b"][:slipped], slip @ DRIVES["b"][slipped:]])}
    some = [
        replace(one, poses=tuple(se3.from_yaw(0.0, (period_m * k, 0.0, 0.0)) @ one.poses[0] for k in (1, 0, -1)))
        for one in pairs((0,))
    ]
    few = {tag: place for tag, place in TAGS.items() if (tag != "t5" if slipped < 10 else tag != "t0")}
    sightings = [*A, *seen("b", few)]
    found = AnchorsForLoops(drives, [], sightings).chosen(some)
    assert len(found) >= 5 and set(found.values()) == {1}
    assert refuted_by_tags(drives, loops(0), sightings) == set()


def _followed(T_odom_last):
    first = se3.inverse(TRUE["a"][-1]) @ TRUE["b"][0]
    return np.stack([T_odom_last @ first @ se3.inverse(DRIVES["b"][0]) @ T for T in DRIVES["b"]])


def loops(shift):
    return [LoopEdge(one.name, one.match, one.query, one.poses[0], np.eye(6)) for one in pairs((shift,))]


def test_tags_refute_loops_that_lie_elsewhere_and_no_true_ones():
    assert refuted_by_tags(DRIVES, loops(0), [*A, *B]) == set()
    assert len(refuted_by_tags(DRIVES, loops(2), [*A, *B])) >= 15


def test_two_tags_or_a_contradicted_one_refute_nothing():
    two = {tag: TAGS[tag] for tag in ("t2", "t3")}
    assert refuted_by_tags(DRIVES, loops(2), [*A, *seen("b", two)]) == set()
    rack = moved((8.0, 0.0, 0.0), "t1", "t2", "t3")
    assert refuted_by_tags(DRIVES, loops(0), [*A, *seen("b", rack)]) == set()
