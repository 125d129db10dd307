"""How many pairs of places in worlds that repeat are accepted with a wrong pose: many worlds, pairs drawn at random.

`python -m lab.repeating_campaign FILE.jsonl --seed S --rounds N` appends a line for each world and round, and sums up
all lines. Each round makes each world anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from scipy.stats import beta

from lab.command_line import run
from lab.worlds.repeating import WORLDS, World, drawn_pairs, judge, visits_of
from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models

VISITS, PAIRS = 12, 24
"""Visits to a world in a round, and pairs drawn of them: half of one place, half a period or an aisle apart."""


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


def upper_bound(wrong: int, pairs: int) -> float:
    """The share of wrong ones that 95 % confidence excludes (Clopper and Pearson; about 3 / pairs where none is)."""
    return 1.0 if wrong >= pairs else float(beta.ppf(0.95, wrong + 1, pairs - wrong))


def summary(lines: Iterable[Counts]) -> list[str]:
    """A Markdown table: each world, and all."""
    by_world: dict[str, Counts] = {}
    for line in lines:
        by_world[line.world] = by_world[line.world] + line if line.world in by_world else line
    rows = list(by_world.values())
    rows.append(sum(rows[1:], rows[0]))
    heads = ("world", "pairs apart", "of one place", "wrong pose accepted", "below, with 95 %", "right", "among")
    table = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for number, row in enumerate(rows):
        name, pairs = ("**all**" if number == len(rows) - 1 else row.world), row.apart + row.same
        table.append(
            f"| {name} | {row.apart} | {row.same} | {row.wrong} | {upper_bound(row.wrong, pairs):.2%} | "
            f"{row.right_apart}, {row.right_same} | {row.among / max(row.same, 1):.2f} |"
        )
    return table


def main(file: Path, seed: int = 0, rounds: int = 0) -> None:
    """Append to FILE a line for each world and round from SEED on, and sum up all of its lines."""
    torch.set_num_threads(1)
    config = PipelineConfig()
    for one in range(seed, seed + rounds):
        for number, world in enumerate(WORLDS):
            line = json.dumps(asdict(run_round(world, 100 * one + number, config)))
            with file.open("a") as lines:
                lines.write(line + "\n")
    print("\n".join(summary(Counts(**json.loads(line)) for line in file.read_text().splitlines())))


if __name__ == "__main__":
    run(main)
