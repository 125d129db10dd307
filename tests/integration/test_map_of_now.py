"""A simulated street over some days: a wall that stood for a while, parked cars drawn anew each day, and what stays.

The map of now has what the last drive left; the map of ever everything; that of a day what stood then.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from revisit.core.merge.evidence import ChangeKind
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.history import changes_over_time
from revisit.core.merge.overlap import points_in_map
from revisit.core.merge.standing import standing
from revisit.evaluation.simulator.city import World, build_city
from revisit.evaluation.simulator.paths import Path
from tests.support.simulated_days import DAY_S, day, empty, parked_anew, returns_of, with_wall

pytestmark = pytest.mark.timeout(1800)

ENDS_M = 5.0
"""Slots nearer than this to an end of the street are seen from one side alone."""

CAR_M, CAR_VOXELS, CAR_HEIGHTS_M = 1.2, 8, (0.5, 1.4)
"""So near to the middle of a slot, and so high, are the points of its car, in so many voxels of 0.4 m at least: crowns
of trees begin above."""


@dataclass(frozen=True)
class Plan:
    """A street, its days, on which of them the wall stands along x, and where its middle is."""

    street: tuple[tuple[float, float], ...]
    seed: int
    days: int
    walled: tuple[int, ...]
    wall: tuple[float, float]
    wall_m: float


SHORT = Plan(((0, 0), (40, 1), (75, 0)), 11, 3, (2,), (30.0, -6.6), 9.0)
FULL = Plan(((0, 0), (60, 3), (120, -2), (170, 0)), 11, 5, (2, 3), (70.0, -6.4), 14.0)


@dataclass(frozen=True)
class Years:
    """What was driven: the town of each day, the submaps of all days, the points (n, 3) of these and their day (n,)."""

    plan: Plan
    towns: list[World]
    maps: list[PlacedMap]
    stays: cKDTree

    @property
    def points(self) -> np.ndarray:
        return np.concatenate([points_in_map(one) for one in self.maps])

    @property
    def days(self) -> np.ndarray:
        return np.repeat([one.session for one in self.maps], [len(one.neural_map.points) for one in self.maps])

    def of_wall(self, points: np.ndarray) -> np.ndarray:
        """Which points are of the wall, its lowest 0.4 m left out: the ground is as near."""
        (x, y), half = self.plan.wall, 0.5 * self.plan.wall_m
        above = points[:, 2] - self.towns[0].ground.height(np.array([self.plan.wall]))[0]
        beside = (np.abs(points[:, 0] - x) < half + 0.3) & (np.abs(points[:, 1] - y) < 0.5)
        return beside & (above > 0.4) & (above < 2.5)

    def taken(self, number: int) -> np.ndarray:
        """Which slots are taken on a day, of those that lie within the street."""
        parking = self.towns[number - 1].parking
        return np.array([parking.occupant(slot, 1) is not None for slot in self.slots])

    @property
    def slots(self) -> list[int]:
        x, last = self.towns[0].parking.position[:, 0], self.plan.street[-1][0]
        return np.flatnonzero((x > ENDS_M) & (x < last - ENDS_M)).tolist()

    def with_cars(self, points: np.ndarray) -> np.ndarray:
        """Which of the slots have a car, by the points of a surface."""
        height = points[:, 2] - self.towns[0].ground.height(points[:, :2])
        voxels = np.unique(np.floor(points[(height > CAR_HEIGHTS_M[0]) & (height < CAR_HEIGHTS_M[1])] / 0.4), axis=0)
        tree = cKDTree(0.4 * (voxels[:, :2] + 0.5))
        places = self.towns[0].parking.position[self.slots][:, :2]
        return np.array([len(found) >= CAR_VOXELS for found in tree.query_ball_point(places, CAR_M)])


@lru_cache(maxsize=1)
def driven(plan: Plan) -> Years:
    """The days of a plan, one drive each."""
    street = Path.through([list(place) for place in plan.street])
    world = build_city([street], seed=plan.seed, drive=street)
    towns = [parked_anew(world, number) for number in range(1, plan.days + 1)]
    towns = [
        with_wall(town, plan.wall, plan.wall_m) if number in plan.walled else town
        for number, town in enumerate(towns, 1)
    ]
    maps = [
        one
        for number, town in enumerate(towns, 1)
        for one in day(town, street, number, 1.7 - 0.3 * (number % 3), number * DAY_S)
    ]
    return Years(plan, towns, maps, cKDTree(returns_of(empty(world), street, 1.2)))


@pytest.fixture(params=[SHORT, pytest.param(FULL, marks=pytest.mark.slow)], ids=["short", "full"])
def years(request) -> Years:
    return driven(request.param)


def test_now_the_wall_is_gone_and_what_stays_is_kept(years):
    points, stands = years.points, np.concatenate(standing(years.maps))
    wall = years.of_wall(points) & np.isin(years.days, years.plan.walled)
    stays = np.isfinite(years.stays.query(points, distance_upper_bound=0.2)[0]) & ~years.of_wall(points)
    left_out, kept = 1.0 - stands[wall].mean(), stands[stays].mean()
    print(f"wall left out {left_out:.4f} of {wall.sum()}, kept {kept:.5f} of {stays.sum()} points of what stays")
    assert wall.sum() > 100 and left_out >= 0.9 and kept >= 0.98


def test_as_of_a_day_on_which_it_stood_the_wall_is_there(years):
    maps = [one for one in years.maps if one.session <= years.plan.walled[-1]]
    points, stands = np.concatenate([points_in_map(one) for one in maps]), np.concatenate(standing(maps))
    assert stands[years.of_wall(points)].mean() >= 0.98


def test_the_cars_of_the_map_of_now_are_those_of_the_last_day(years):
    taken, points = years.taken(years.plan.days), years.points
    now, ever = (years.with_cars(points[rows]) for rows in (np.concatenate(standing(years.maps)), slice(None)))
    right = (now & taken).sum()
    print(f"cars of now: precision {right}/{now.sum()}, recall {right}/{taken.sum()}; of ever {ever.sum()} slots")
    assert right >= 0.9 * now.sum() and right >= 0.9 * taken.sum() and ever.sum() > now.sum()


def test_the_drives_that_found_the_wall_and_found_it_gone_say_so(years):
    (x, y), half = years.plan.wall, 0.5 * years.plan.wall_m
    found = [one for one in changes_over_time(years.maps) if abs(one.thing.centre_m[1] - y) < 1.0]
    found = [one for one in found if abs(one.thing.centre_m[0] - x) < half and one.thing.extent_m[0] > 1.5 * half]
    told = [(one.thing.kind, one.session) for one in found]
    came, went = years.plan.walled[0], years.plan.walled[-1] + 1
    assert told == [(ChangeKind.APPEARED, came), (ChangeKind.VANISHED, went)]
