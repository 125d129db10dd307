"""serve, worker, migrate: the service's own commands."""

from __future__ import annotations

import os
from pathlib import Path

import typer


def run_service(command: str, **settings: Path | str | int | None) -> None:
    """`python -m revisit.service COMMAND` in this process, with settings given as REVISIT_* variables."""
    for name, value in settings.items():
        if value is not None:
            os.environ[f"REVISIT_{name.upper()}"] = str(value)
    from revisit.service.__main__ import main

    raise typer.Exit(main([command]))
