"""Cars that left and cars that came between two days on simulated streets: which of them the merge finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from revisit.core.merge.evidence import ChangedThing, ChangeKind
from revisit.core.merge.history import changes_between
from revisit.core.merge.overlap import pairs_in_reach
from revisit.evaluation.simulator.city import World, build_city
from revisit.evaluation.simulator.paths import Path
from tests.support.simulated_days import day, parked_anew

pytestmark = pytest.mark.slow

STREET = Path.through([[0, 0], [60, 3], [120, -2], [170, 0]])
ENDS_M = (5.0, 165.0)
"""Slots beyond are seen from one side alone."""

CAR_M = 3.5
"""What is nearer than this to the middle of a slot belongs to it."""


@dataclass(frozen=True)
class Slots:
    """Kerbside slots: positions (n, 2), and which are taken on either day (n,)."""

    places: np.ndarray
    before: np.ndarray
    after: np.ndarray

    def changed(self, kind: ChangeKind) -> np.ndarray:
        return self.before & ~self.after if kind is ChangeKind.VANISHED else self.after & ~self.before

    def of(self, thing: ChangedThing) -> np.ndarray:
        """The slots within a metre of its box."""
        centre, half = np.array(thing.centre_m[:2]), 0.5 * np.array(thing.extent_m[:2]) + 1.0
        return (np.abs(self.places - centre) < half).all(axis=1)

    def swapped(self, thing: ChangedThing) -> bool:
        """Whether it is where another car stands now: a part of one may have vanished, or appeared."""
        both = self.places[self.before & self.after]
        return bool((np.linalg.norm(both - np.array(thing.centre_m[:2]), axis=1) < CAR_M).any())


def slots_of(world: World, later: World) -> Slots:
    taken = [
        np.array([one.parking.occupant(slot, 1) is not None for slot in range(len(one.parking.yaw))])
        for one in (world, later)
    ]
    return Slots(world.parking.position[:, :2], taken[0], taken[1])


def scores(seed: int) -> tuple[int, int, int, int]:
    """Right and wrong things, and found and wanted slots, of one street whose parked cars are all drawn anew."""
    world = build_city([STREET], seed=seed, drive=STREET)
    later = parked_anew(world, 1)
    days = day(world, STREET, 1, 1.7, 100.0), day(later, STREET, 2, 1.2, 200.0)
    places = [np.stack([one.T_map_submap[:3, 3] for one in maps]) for maps in days]
    pairs = [(days[0][one], days[1][other]) for one, other in pairs_in_reach(places[0], places[1], 25.0, most=100)]
    slots, things = slots_of(world, later), changes_between(pairs)
    hits = [(thing, slots.of(thing) & slots.changed(ChangeKind(thing.kind))) for thing in things]
    right = sum(bool(hit.any()) for _, hit in hits)
    wrong = sum(not hit.any() and not slots.swapped(thing) for thing, hit in hits)
    inside = (slots.places[:, 0] > ENDS_M[0]) & (slots.places[:, 0] < ENDS_M[1])
    found, wanted = 0, 0
    for kind in (ChangeKind.VANISHED, ChangeKind.APPEARED):
        of_kind = slots.changed(kind) & inside
        seen = np.any([hit for thing, hit in hits if thing.kind is kind] or [np.zeros_like(inside)], axis=0)
        found, wanted = found + int((of_kind & seen).sum()), wanted + int(of_kind.sum())
    return right, wrong, found, wanted


def test_cars_that_left_or_came_are_found_and_little_else_is():
    right, wrong, found, wanted = np.sum([scores(seed) for seed in (11, 12, 13)], axis=0)
    print(f"precision {right}/{right + wrong}, recall {found}/{wanted}")
    assert right >= 0.85 * (right + wrong) and found >= 0.9 * wanted
