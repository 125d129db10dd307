"""Twins that only radio tells apart: two storeys, or two wings, of one plan, in worlds that also repeat.

`python -m lab.radio_twins --seed S --rounds N`: one drive maps both twins, another drives one of them and asks. Loops
as the service accepts them without radio, with it, with a fifth of the identifiers false, with all access points
replaced between the drives, with fingerprints of another time of the drive, and with those of the other twin.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lab.command_line import run
from lab.recognition.remembered_verdicts import RememberedPairs
from lab.worlds.repeating import WORLDS, Samples, World, box, described, is_right, joined, on_the_way, plate
from revisit.core.acceptance import Station
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.index import Match
from revisit.core.model_bundle import load_packaged_models
from revisit.core.radio import RadioFingerprint
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.drive_acceptance import AskedPlaces, accepted_loops, judge_drive
from revisit.evaluation.loop_closure_method import RevisitMethod


def _rooms(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    """Ten metres of a plan that does not repeat: walls with doors, and shelves; a cart that another day moves."""
    parts, up = [], np.array([0.0, 0.0, 1.5])
    for side in (-1.0, 1.0):
        y, door = side * lasting.uniform(3.0, 9.0), lasting.uniform(2.0, 7.0)
        for start, end in ((0.0, door), (door + 1.5, 10.0)):
            across = np.array([-0.5 * side * (end - start), 0.0, 0.0])
            parts.append(plate((0.5 * (start + end), y, 1.5), across, up, passing))
        for _ in range(3):
            at = (lasting.uniform(0.5, 9.5), side * lasting.uniform(1.8, abs(y)))
            parts.append(
                box(at, (lasting.uniform(0.3, 2.0), lasting.uniform(0.3, 1.0), lasting.uniform(0.8, 2.8)), passing)
            )
    cart = (passing.uniform(1.0, 9.0), passing.uniform(-3.0, 3.0))
    return joined([*parts, box(cart, (0.8, 0.6, 1.0), passing)])


PLAN = World("rooms", 10.0, _rooms)
"""Of a storey, or a wing; the other twin has the same."""

TWINS = {"storeys": (0.0, 0.0, 4.0), "wings": (150.0, 60.0, 0.0)}
HALL, HALL_SEED, IN_HALL = (-90.0, 0.0, 0.0), 7_000_000, 4
"""Before the twins every drive passes a hall, of which there is one: so many submaps."""

SUBMAPS = 6

ACCESS_POINTS = 16
"""Of a twin of 80 by 30 m: one for 150 m^2."""

LOSS, FLOOR_DB, SHADOW_DB, FAINTEST_DBM = 2.8, 17.0, 4.0, -88.0
"""Of a building: exponent of the distance, a ceiling, fading of a reading, and the faintest that is heard."""


@dataclass(frozen=True)
class AccessPoints:
    """Positions (n, 3) and identifiers."""

    positions: NDArray[np.float64]
    names: tuple[bytes, ...]

    def heard(self, at: NDArray[np.float64], rng: np.random.Generator) -> RadioFingerprint:
        """The mean of five readings at a place."""
        apart = self.positions - at
        floors = np.round(np.abs(apart[:, 2]) / 4.0)
        mean = -38.0 - 10.0 * LOSS * np.log10(np.maximum(np.linalg.norm(apart, axis=1), 1.0)) - FLOOR_DB * floors
        readings = []
        for dbm in mean + rng.normal(0.0, SHADOW_DB, (5, len(mean))):
            readings.append({name: float(one) for name, one in zip(self.names, dbm, strict=True) if one > FAINTEST_DBM})
        return RadioFingerprint.of(readings)


def access_points(twin: NDArray[np.float64], seed: int) -> AccessPoints:
    """One for about 150 m^2 around both twins, on the ceiling."""
    rng, positions = np.random.default_rng([seed, 8]), []
    for offset in (np.zeros(3), twin, np.array(HALL)):
        along, aside = rng.uniform(-20, 60, ACCESS_POINTS), rng.uniform(-15, 15, ACCESS_POINTS)
        spread = np.column_stack([along, aside, np.full(ACCESS_POINTS, 2.8)])
        positions.append(spread + offset)
    every = np.concatenate(positions)
    return AccessPoints(every, tuple(rng.bytes(8) for _ in every))


@dataclass(frozen=True)
class HeardPlaces(AskedPlaces):
    """Places with the fingerprints of their submaps."""

    of_queries: Sequence[RadioFingerprint | None] = field(default_factory=list)
    of_mapped: Sequence[RadioFingerprint | None] = field(default_factory=list)

    def query(self, number: int) -> Station:
        """See AskedPlaces."""
        return replace(super().query(number), radio=self.of_queries[number])

    def match(self, row: int) -> Station:
        """See AskedPlaces."""
        return replace(super().match(row), radio=self.of_mapped[row])


def twins(world: World, offset: tuple[float, float, float], seed: int, config: PipelineConfig) -> AskedPlaces:
    """One drive through a hall and both twins, which asks nothing, and one through the hall and one of the twins."""
    rng = np.random.default_rng([seed, 5])
    asked, turn = int(rng.integers(2)), float(rng.choice([0.0, np.pi]))
    parts = [(0, 0, HALL, 0.0), (1, 0, offset, 0.0), (2, 1, offset, 0.0), (3, 0, HALL, 0.0), (4, asked, offset, turn)]
    made = []
    for part, twin, by, towards in parts:
        of, count = (HALL_SEED + seed, IN_HALL) if by is HALL else (seed, SUBMAPS)
        start_m = rng.uniform(-5.0, 5.0) if part > 2 else 0.0
        poses = [on_the_way(start_m + number * config.submap.stride, towards, rng) for number in range(count)]
        ordered = poses[::-1] if towards else poses
        codebooks = load_packaged_models().codebooks
        seen = [
            described(PLAN if by is HALL else world, one, (of, part, n), codebooks, config)
            for n, one in enumerate(ordered)
        ]
        made.append([_moved(one, np.array(by) * (1 if by is HALL else twin)) for one in seen])
    return AskedPlaces(_in_order([*made[3], *made[4]]), _in_order([*made[0], *made[1], *made[2]]), one_drive=False)


def _in_order(places: list[DescribedSubmap]) -> list[DescribedSubmap]:
    return [replace(one, id=row, window=(row,)) for row, one in enumerate(places)]


def _moved(place: DescribedSubmap, by: NDArray[np.float64]) -> DescribedSubmap:
    """A submap in another part of the site."""
    pose = se3.from_yaw(0.0, tuple(by)) @ place.T_world_submap
    return replace(place, position=pose[:3, 3], T_world_submap=pose)


def _heard(places: AskedPlaces, aps: tuple[AccessPoints, AccessPoints], seed: int) -> HeardPlaces:
    """The fingerprints of the submaps, of access points at the time of the map, and at that of the questions."""
    rng = np.random.default_rng([seed, 9])
    mapped = [aps[0].heard(one.position, rng) for one in places.mapped]
    return HeardPlaces(
        places.queries, places.mapped, False, [aps[1].heard(one.position, rng) for one in places.queries], mapped
    )


def _spoiled(places: HeardPlaces, share: float, seed: int) -> HeardPlaces:
    """So large a share of the identifiers is another one, anew in each fingerprint."""
    rng = np.random.default_rng([seed, 10])

    def spoiled(one: RadioFingerprint | None) -> RadioFingerprint:
        heard = {} if one is None else one.heard
        return RadioFingerprint({rng.bytes(8) if rng.random() < share else name: dbm for name, dbm in heard.items()})

    return replace(places, of_queries=[*map(spoiled, places.of_queries)], of_mapped=[*map(spoiled, places.of_mapped)])


def _late(places: HeardPlaces, by: int) -> HeardPlaces:
    """The fingerprints of the asking drive are those of so many submaps before."""
    told = list(places.of_queries)
    return replace(places, of_queries=[told[max(number - by, 0)] for number in range(len(told))])


def _of_the_other_twin(places: HeardPlaces, offset: NDArray[np.float64], aps: AccessPoints, seed: int) -> HeardPlaces:
    """A lie: the asking drive tells the radio of the twin that it is not in."""
    rng = np.random.default_rng([seed, 11])
    middle = np.mean([one.position for one in places.queries[IN_HALL:]], axis=0)
    starts = (IN_HALL, IN_HALL + SUBMAPS)
    centres = [np.mean([one.position for one in places.mapped[at : at + SUBMAPS]], axis=0) for at in starts]
    by = offset if np.linalg.norm(middle - centres[0]) < np.linalg.norm(middle - centres[1]) else -offset
    return replace(places, of_queries=[aps.heard(one.position + by, rng) for one in places.queries])


def run_round(world: World, kind: str, seed: int, config: PipelineConfig) -> dict[str, tuple[int, int]]:
    """Accepted loops with a wrong pose, and with the right one, by the radio."""
    offset = TWINS[kind]
    places = twins(world, offset, seed, config)
    method = RememberedPairs(RevisitMethod(config))
    old, new = access_points(np.array(offset), seed), access_points(np.array(offset), seed + 50_000)
    told = _heard(places, (old, old), seed)
    lie = _of_the_other_twin(told, np.array(offset), old, seed)
    variants = {
        "none": places,
        "radio": told,
        "20 % false": _spoiled(told, 0.2, seed),
        "50 % false": _spoiled(told, 0.5, seed),
        "replaced": _heard(places, (old, new), seed),
        "3 submaps late": _late(told, 3),
        "of the other twin": lie,
        "of it from the hall on": replace(lie, of_queries=[*told.of_queries[:IN_HALL], *lie.of_queries[IN_HALL:]]),
    }
    return {name: _counts(one, method, seed) for name, one in variants.items()}


def _counts(places: AskedPlaces, method: RememberedPairs, seed: int) -> tuple[int, int]:
    rng, count = np.random.default_rng([seed, 6]), len(places.mapped)
    candidates = [tuple(Match(int(row), 1.0) for row in rng.permutation(count)) for _ in places.queries]
    found = accepted_loops(places, judge_drive(places, method, candidates, 1, lambda _: None))
    right = sum(is_right(*error) for error in zip(found.metres, found.degrees, strict=True))
    return len(found.pairs) - right, right


def main(file: Path, seed: int = 0, rounds: int = 1, worlds: str = "") -> None:
    """Append a line for each world, kind and round, and sum up all."""
    torch.set_num_threads(1)
    config = PipelineConfig()
    for one in range(seed, seed + rounds):
        for number, world in enumerate((PLAN, *WORLDS)):
            if worlds and world.name not in worlds.split(","):
                continue
            for kind in TWINS:
                line = {
                    "world": world.name,
                    "kind": kind,
                    "seed": one,
                    "counts": run_round(world, kind, 100 * one + number, config),
                }
                with file.open("a") as lines:
                    lines.write(json.dumps(line) + "\n")
    total: dict[str, dict[str, list[int]]] = {}
    for line in map(json.loads, file.read_text().splitlines()):
        for name, (wrong, right) in line["counts"].items():
            of = total.setdefault(line["kind"], {}).setdefault(name, [0, 0])
            of[0] += wrong
            of[1] += right
    for kind, rows in total.items():
        for name, (wrong, right) in rows.items():
            print(f"| {kind} | {name} | {wrong} | {right} |")


if __name__ == "__main__":
    run(main)
