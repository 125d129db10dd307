"""`python -m lab.domains`: recognition in worlds that are built differently."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lab.command_line import named, run
from revisit.cli.output import progress_bar, reporter, say


def domains(
    out: Annotated[Path, typer.Option(help="Folder for the report, its pictures and the results.")] = Path(
        "out/domains"
    ),
    only: Annotated[str, typer.Option(help="Domains by name, with commas; all by default.")] = "",
    share: Annotated[
        float, typer.Option(min=0.1, max=1.0, help="How much of the winding ways is driven, 0.1 to 1.")
    ] = 1.0,
    candidates: Annotated[int, typer.Option(min=0, max=1000, help="First answers that are verified; 0: none.")] = 20,
) -> None:
    """Recognition in worlds built differently, with the worst of them; a second run goes on where the first ended.

    Domains of real data are left out unless REVISIT_DATA names their folder.
    """
    from lab.domains.catalogue import DOMAINS
    from lab.domains.evaluation import run_domains

    names = named("--only", only, [domain.name for domain in DOMAINS])
    chosen = [domain for domain in DOMAINS if domain.name in names]
    with progress_bar(quiet=False) as bar:
        files = run_domains(chosen, out, reporter(bar), share=share, candidates=candidates)
    for domain in chosen:
        if domain.missing:
            say(f"{domain.name} was left out: {domain.missing}")
    say(f"{files[0]} and {files[1]}")


if __name__ == "__main__":
    run(domains)
