"""How well a conversation places a robot: `python -m lab.relocalisation FOLDER [--settings garage-800,hku]`.

Prints a line a setting: a map and ways through it on another day, in simulated worlds and real recordings. Places and
verdicts are kept in FOLDER: times are those of a run in a new one, or of one with `--among`, which keeps no verdict.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Annotated

import torch
import typer

from lab.command_line import named, run
from lab.relocalisation.recordings import among_others, kept, settings
from lab.relocalisation.table import HEAD, Held, SettingPlaces, hold, row_of, story_of


def main(
    folder: Path,
    only: Annotated[str, typer.Option("--settings", help="Names with commas; all by default.")] = "",
    most: Annotated[int, typer.Option(help="Conversations of each setting.")] = 1_000,
    stories: Annotated[bool, typer.Option("--stories", help="Print each conversation, too.")] = False,
    among: Annotated[int, typer.Option(help="Places of --of to put into each map, far away.")] = 0,
    of: Annotated[str, typer.Option(help="Settings of the same configuration whose places those are.")] = "garage-800",
) -> None:
    """Hold the conversations of each setting, and sum up."""
    torch.set_num_threads(1)
    known = settings(folder)
    rows = []
    for name in named("--settings", only, list(known)):
        setting, verdicts = kept(folder, name, known[name]), folder / f"{name}.verdicts"
        if among:
            others = [
                place for other in named("--of", of, list(known)) for place in kept(folder, other, known[other]).known
            ]
            setting = among_others(setting, others, among)
        places = SettingPlaces(setting)
        if verdicts.exists() and not among:
            places.verdicts = pickle.loads(verdicts.read_bytes())  # noqa: S301  # made below
        held = list[Held]()
        for number in range(min(most, len(places.setting.conversations))):
            held.append(hold(places, number))
            if stories:
                print(story_of(number, held[-1]), flush=True)
            if not among:
                verdicts.write_bytes(pickle.dumps(places.verdicts))
        rows.append(row_of(name, held))
    print("\n".join([HEAD, *rows]))


if __name__ == "__main__":
    run(main)
