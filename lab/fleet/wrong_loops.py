"""Wrong loops for the map of a fleet: random ones, and aliases that agree with each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from revisit.core.geometry import se3
from revisit.evaluation.demo.truth import FoundLoop

ALIAS_LENGTH = 10
"""Successive loops that agree with each other: a street taken for another one over so many submaps."""

LEAST_DISTANCE_M = 30.0
"""So far apart are the two places of a wrong loop in truth."""

REACH_M = 5.0
"""How far apart a wrong loop puts its ends, along each axis at most."""

REGISTRATION_SIGMAS = 0.02, 0.002
"""Standard deviations of a registration's error: metres and radians."""


@dataclass(frozen=True)
class PlacedSubmap:
    """A submap of a session, its place in it, and where it truly lies."""

    name: str
    session: str
    ordinal: int
    T_world_submap: se3.Matrix4


def random_loops(submaps: Sequence[PlacedSubmap], count: int, seed: int) -> list[FoundLoop]:
    """Wrong loops between random submaps that lie far from each other."""
    rng = np.random.default_rng([seed, 81])
    wrong: list[FoundLoop] = []
    while len(wrong) < count:
        match, query = (submaps[int(n)] for n in rng.integers(len(submaps), size=2))
        if _distance_m(match, query) > LEAST_DISTANCE_M:
            wrong.append(FoundLoop(query.name, match.name, _random_motion(rng)))
    return wrong


def agreeing_loops(submaps: Sequence[PlacedSubmap], count: int, seed: int) -> list[FoundLoop]:
    """Runs of `ALIAS_LENGTH` wrong loops that put one stretch of a drive on another one, wrongly but alike."""
    rng = np.random.default_rng([seed, 82])
    wrong: list[FoundLoop] = []
    by_place = {(one.session, one.ordinal): one for one in submaps}
    while len(wrong) < count:
        first, second = (submaps[int(n)] for n in rng.integers(len(submaps), size=2))
        places = [
            [by_place.get((one.session, one.ordinal + step)) for step in range(ALIAS_LENGTH)]
            for one in (first, second)
        ]  # fmt: skip
        pairs = [
            (match, query) for match, query in zip(*places, strict=True) if match is not None and query is not None
        ]
        if len(pairs) == ALIAS_LENGTH and all(_distance_m(*pair) > LEAST_DISTANCE_M for pair in pairs):
            wrong += _alias(pairs, rng)
    return wrong[:count]


def _alias(pairs: list[tuple[PlacedSubmap, PlacedSubmap]], rng: np.random.Generator) -> list[FoundLoop]:
    """Loops that all say the same of two stretches, up to the noise of a registration."""
    (match, query), T_first_second = pairs[0], _random_motion(rng)
    T_wrong = match.T_world_submap @ T_first_second @ se3.inverse(query.T_world_submap)
    return [
        FoundLoop(
            there.name, here.name, se3.inverse(here.T_world_submap) @ T_wrong @ there.T_world_submap @ _noise(rng)
        )
        for here, there in pairs
    ]


def _distance_m(one: PlacedSubmap, other: PlacedSubmap) -> float:
    return float(np.linalg.norm(one.T_world_submap[:3, 3] - other.T_world_submap[:3, 3]))


def _random_motion(rng: np.random.Generator) -> se3.Matrix4:
    return se3.from_yaw(rng.uniform(-np.pi, np.pi), (*rng.uniform(-REACH_M, REACH_M, 2), 0.0))


def _noise(rng: np.random.Generator) -> se3.Matrix4:
    return se3.exp(rng.normal(size=6) * np.repeat(REGISTRATION_SIGMAS, 3))
