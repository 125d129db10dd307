"""`revisit demo`: a service, two simulated robots, and their loops against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.output import emit_json


@needs("evaluation")
def demo(
    picture: Annotated[Path, typer.Option(help="PNG to write.")] = Path("out/demo.png"),
    seed: Annotated[int, typer.Option(help="Seed of the simulated town.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Print the exit status as JSON at the end.")] = False,
) -> None:
    """Start a service, drive two simulated robots through a town, compare the loops with the truth."""
    from revisit.cli.demo.run import run_demo

    status = run_demo(picture, seed=seed)
    if json:
        emit_json({"targets_reached": status == 0, "picture": str(picture)})
    raise typer.Exit(status)
