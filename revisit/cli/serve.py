"""`revisit serve` and `migrate`: the service's own commands."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.options import Home
from revisit.cli.output import signs


@needs("service")
def serve(
    home: Home = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    http_port: Annotated[int | None, typer.Option(help="REST port; 0 takes a free one.")] = None,
    grpc_port: Annotated[int | None, typer.Option(help="gRPC port; 0 takes a free one.")] = None,
    workers: Annotated[int | None, typer.Option(help="Worker processes.")] = None,
) -> None:
    """Run the service: REST, gRPC and workers; its log is JSON. Options stand above the REVISIT_* variables."""
    _run("serve", home=home, host=host, http_port=http_port, grpc_port=grpc_port, workers=workers)


def _run(command: str, **settings: Path | str | int | None) -> None:
    """`python -m revisit.service COMMAND` in this process, with settings given as REVISIT_* variables."""
    for name, value in settings.items():
        if value is not None:
            os.environ[f"REVISIT_{name.upper()}"] = str(value)
    signs.end()  # the log follows on stderr
    from revisit.service.__main__ import main

    raise typer.Exit(main([command]))
