"""The command line as a whole: which commands there are, and how a refusal is told."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from revisit.cli import (
    anchors,
    audit,
    backup,
    bench,
    catalogue,
    demo,
    doctor,
    evaluate,
    export,
    ingest,
    inspect,
    keys,
    maps,
    merging,
    move,
    operations,
    plan,
    plans,
    queries,
    reembed,
    serve,
    spool,
    watch,
)
from revisit.cli.former_names import WithFormerNames

app = typer.Typer(
    name="revisit",
    cls=WithFormerNames,
    help="Loop closure as a service for robot fleets.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        from revisit.cli.extras import DISTRIBUTION

        typer.echo(f"revisit {metadata.version(DISTRIBUTION)}")
        raise typer.Exit


COMMANDS = (
    serve.serve, inspect.inspect, ingest.ingest, spool.spool, catalogue.maps, catalogue.delete, queries.query,
    queries.loops, watch.watch, export.export, merging.merge, operations.operations, demo.demo, evaluate.evaluate,
    bench.bench, plan.plan, doctor.doctor, audit.audit, reembed.reembed, backup.backup, backup.restore, backup.scrub,
    move.move,
)  # fmt: skip
GROUPS = {
    "map": maps.group,
    "anchors": anchors.group,
    "plans": plans.group,
    "keys": keys.group,
}


@app.callback()
def about(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Loop closure as a service for robot fleets."""


for command in COMMANDS:
    app.command()(command)
for name, group in GROUPS.items():
    app.add_typer(group, name=name)


def run() -> None:
    """Run a command; a refusal of the service is one line, with exit status 1."""
    from revisit.cli.output import signs
    from revisit.core.errors import RevisitError
    from revisit.sdk.errors import ApiError

    # gRPC writes lines of its own where the service it talks to stops or falls idle, in the middle of a bar.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
    try:
        with signs:
            app()
    except (ApiError, RevisitError, OSError, TimeoutError) as error:
        typer.echo(f"revisit: {error}", err=True)
        raise SystemExit(1) from error
    except Exception as error:
        broken = getattr(error, "orig", error)  # SQLAlchemy wraps it
        if type(broken).__module__ != "sqlite3":  # the command line itself knows no database
            raise
        typer.echo(
            f"revisit: the database cannot be read: {broken}. `revisit doctor` looks at it, `revisit restore` makes a "
            "data folder of a backup",
            err=True,
        )
        raise SystemExit(1) from error
