"""How many pairs of places in worlds that repeat are accepted with a wrong pose, in many worlds.

`python -m lab.repeating_campaign FILE.jsonl --seed S --rounds N` draws pairs at random and judges each alone; with
`--drives` one drive asks another, and the pairs are judged alone and as the service accepts them. It appends a line for
each world and round, and sums up all lines of FILE.jsonl. Each round makes each world anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from scipy.stats import beta

from lab.command_line import run
from lab.recognition.remembered_verdicts import RememberedPairs
from lab.worlds.repeating import WORLDS, World, drawn_pairs, is_right, judge, two_drives, visits_of
from revisit.core.config import PipelineConfig
from revisit.core.index import Match
from revisit.core.model_bundle import load_packaged_models
from revisit.core.verification import VerifiedLoop
from revisit.evaluation.drive_acceptance import AskedPlaces, PairMethod, accepted_loops, judge_drive
from revisit.evaluation.loop_closure_method import RevisitMethod
from revisit.evaluation.matching import pose_error

VISITS, PAIRS = 12, 24
"""Visits to a world in a round, and pairs drawn of them: half of one place, half a period or an aisle apart."""

SUBMAPS = 6
"""Submaps of each of two drives through a world in a round."""


@dataclass(frozen=True)
class Counts:
    """Pairs of a world: apart and of one place, accepted with a wrong pose, accepted of each kind with the right one.

    among: of the pairs of one place, those whose true pose is the accepted one or a hypothesis.
    """

    world: str
    seed: int
    apart: int = 0
    same: int = 0
    wrong: int = 0
    right_apart: int = 0
    right_same: int = 0
    among: int = 0

    def __add__(self, other: Counts) -> Counts:
        """The counts of both."""
        mine, theirs = asdict(self), asdict(other)
        return Counts(self.world, self.seed, **{k: mine[k] + theirs[k] for k in mine if k not in ("world", "seed")})


Row = TypeVar("Row", Counts, "DriveCounts")


def run_round(world: World, seed: int, config: PipelineConfig) -> Counts:
    """One world made from `seed`: VISITS visits, PAIRS pairs."""
    seen = visits_of(world, VISITS, seed, load_packaged_models().codebooks, config)
    total = Counts(world.name, seed)
    for same in (False, True):
        for pair in drawn_pairs(world, seen, PAIRS // 2, seed, same=same):
            found = judge(pair, config)
            right = found.accepted and found.right
            total += Counts(
                world.name, seed, int(not same), int(same), int(found.false), int(right and not same),
                int(right and same), int(same and found.among),
            )  # fmt: skip
    return total


@dataclass(frozen=True)
class DriveCounts:
    """Pairs of the submaps of two drives: accepted with a wrong pose and with the right one, alone and as served."""

    world: str
    seed: int
    pairs: int = 0
    alone_wrong: int = 0
    alone_right: int = 0
    served_wrong: int = 0
    served_right: int = 0

    def __add__(self, other: DriveCounts) -> DriveCounts:
        """The counts of both."""
        mine, theirs = asdict(self), asdict(other)
        return DriveCounts(
            self.world, self.seed, **{k: mine[k] + theirs[k] for k in mine if k not in ("world", "seed")}
        )


def run_drives(world: World, seed: int, config: PipelineConfig, submaps: int = SUBMAPS) -> DriveCounts:
    """One world made from `seed`: each submap of a drive asks all of another one, and is judged alone and as served."""
    places = two_drives(world, submaps, seed, load_packaged_models().codebooks, config)
    method = RememberedPairs(RevisitMethod(config))
    alone = _errors_of_passing_pairs(places, method)
    drive = judge_drive(places, method, _in_any_order(places, seed), 1, lambda _: None)
    served = accepted_loops(places, drive)
    errors = list(zip(served.metres, served.degrees, strict=True))
    return DriveCounts(world.name, seed, len(places.queries) * len(places.mapped), *_split(alone), *_split(errors))


def _in_any_order(places: AskedPlaces, seed: int) -> list[tuple[Match, ...]]:
    """All submaps of the map for each query: they are as like it as one another."""
    rng, count = np.random.default_rng([seed, 6]), len(places.mapped)
    return [tuple(Match(int(row), 1.0) for row in rng.permutation(count)) for _ in places.queries]


def _errors_of_passing_pairs(places: AskedPlaces, method: PairMethod) -> list[tuple[float, float]]:
    """How far the poses of the pairs that pass alone are off, metres and degrees."""
    errors = []
    for query, match in product(places.queries, places.mapped):
        if query.description is not None and match.description is not None:
            verdict = method.verify_pair(query.description.place, match.description.place, 1.0)
            if isinstance(verdict, VerifiedLoop):
                errors.append(pose_error(query, match, verdict.measurement.T_match_query))
    return errors


def _split(errors: Sequence[tuple[float, float]]) -> tuple[int, int]:
    """How many poses are wrong, and how many right."""
    right = sum(is_right(*error) for error in errors)
    return len(errors) - right, right


def upper_bound(wrong: int, pairs: int) -> float:
    """The share of wrong ones that 95 % confidence excludes (Clopper and Pearson; about 3 / pairs where none is)."""
    return 1.0 if wrong >= pairs else float(beta.ppf(0.95, wrong + 1, pairs - wrong))


def summary(lines: Iterable[Counts]) -> list[str]:
    """A Markdown table of pairs drawn at random: each world, and all."""
    rows = _summed(lines)
    heads = ("world", "pairs apart", "of one place", "wrong pose accepted", "below, with 95 %", "right", "among")
    table = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for number, row in enumerate(rows):
        name, pairs = ("**all**" if number == len(rows) - 1 else row.world), row.apart + row.same
        table.append(
            f"| {name} | {row.apart} | {row.same} | {row.wrong} | {upper_bound(row.wrong, pairs):.2%} | "
            f"{row.right_apart}, {row.right_same} | {row.among / max(row.same, 1):.2f} |"
        )
    return table


def drives_summary(lines: Iterable[DriveCounts]) -> list[str]:
    """A Markdown table of pairs of two drives: each world, and all."""
    rows = _summed(lines)
    heads = ("world", "pairs", "alone: wrong", "right", "as served: wrong", "right")
    table = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for number, row in enumerate(rows):
        name = "**all**" if number == len(rows) - 1 else row.world
        counts = (row.pairs, row.alone_wrong, row.alone_right, row.served_wrong, row.served_right)
        table.append(f"| {name} | {' | '.join(map(str, counts))} |")
    return table


def _summed(lines: Iterable[Row]) -> list[Row]:
    """The sums of each world, and of all."""
    by_world: dict[str, Row] = {}
    for line in lines:
        by_world[line.world] = by_world[line.world] + line if line.world in by_world else line
    worlds: list[Row] = list(by_world.values())
    whole = worlds[0]
    for one in worlds[1:]:
        whole = whole + one
    worlds.append(whole)
    return worlds


def main(file: Path, seed: int = 0, rounds: int = 0, drives: bool = False) -> None:
    """Append to FILE a line for each world and round from SEED on, and sum up all of its lines."""
    torch.set_num_threads(1)
    config = PipelineConfig()
    for one in range(seed, seed + rounds):
        for number, world in enumerate(WORLDS):
            of_world = 100 * one + number
            made = run_drives(world, of_world, config) if drives else run_round(world, of_world, config)
            with file.open("a") as lines:
                lines.write(json.dumps(asdict(made)) + "\n")
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    table = drives_summary(DriveCounts(**row) for row in rows) if drives else summary(Counts(**row) for row in rows)
    print("\n".join(table))


if __name__ == "__main__":
    run(main)
