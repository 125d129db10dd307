"""`python -m lab.fleet`: a simulated fleet through a service, with wrong loops in its map, against the truth.

drives       three robots on two days in one town, with the odometry of each
recording    their drives streamed into a service, once
wrong_loops  random loops, and aliases that agree with each other
spoiling     these put into a copy of the service's data
run          each copy optimised by a service of its own, and compared with the truth
scores, figure
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lab.command_line import named, run
from revisit.cli.output import progress_bar, reporter, say


def fleet(
    out: Annotated[Path, typer.Option(help="Folder for the drives, the table, the pictures and TUM files.")] = Path(
        "out/fleet"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the simulated town.")] = 1,
    only: Annotated[str, typer.Option(help="Kinds of wrong loops by name, with commas; all by default.")] = "",
) -> None:
    """Stream a simulated fleet into a service, put wrong loops into its map, compare the maps with the truth.

    The drives are streamed once: a second run goes on with the files of the first in OUT.
    """
    from lab.fleet.run import SPOILINGS, run_fleet

    chosen = named("--only", only, tuple(SPOILINGS))
    with progress_bar(quiet=False) as bar:
        outcomes = run_fleet(out, seed, reporter(bar), chosen)
    say((out / "fleet.md").read_text().rstrip("\n"))
    if not all(one.reached for one in outcomes):
        raise typer.Exit(1)


if __name__ == "__main__":
    run(fleet)
