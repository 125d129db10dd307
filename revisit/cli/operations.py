"""`revisit operations`: the work of the service, and the way of failed work back into its queue."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import HTTP, Http, Json
from revisit.cli.output import emit_json, emit_table, refuse

if TYPE_CHECKING:
    from revisit.sdk.resources import Operation

STATES = ("QUEUED", "RUNNING", "DONE", "FAILED", "ALL")

group = typer.Typer(help="Look at the service's work, and queue again what has failed.", no_args_is_help=True)


@group.command("list")
def list_operations(
    state: Annotated[str, typer.Option(help="QUEUED, RUNNING, DONE, FAILED or ALL.")] = "FAILED",
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List operations with what they are about and why they failed; by default those that failed for good."""
    from revisit.sdk.client import Client

    if state.upper() not in STATES:
        raise refuse(f"--state is one of {', '.join(STATES)}")
    with Client(http) as client:
        _emit(client.list_operations(state=None if state.upper() == "ALL" else state.upper()), json)


@group.command("retry")
def retry(
    names: Annotated[list[str] | None, typer.Argument(help="Their ids.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Every description that has failed.")] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Queue failed descriptions again, with as many attempts as new ones."""
    from revisit.sdk.client import Client

    if every == bool(names):
        raise refuse("give either ids or --all")
    with Client(http) as client:
        failed = client.list_operations(state="FAILED") if every else []
        chosen = [operation.name for operation in failed if operation.kind == "DESCRIBE_SUBMAP"]
        chosen += [f"operations/{given.removeprefix('operations/')}" for given in names or []]
        _emit([client.retry_operation(name) for name in chosen], json)


@group.command("cancel")
def cancel(name: Annotated[str, typer.Argument(help="Its id.")], http: Http = HTTP, json: Json = False) -> None:
    """End an operation that optimises or merges maps: at once where it waits, else at its next step."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        _emit([client.cancel_operation(f"operations/{name.removeprefix('operations/')}")], json)


def _emit(operations: list[Operation], as_json: bool) -> None:
    if as_json:
        emit_json([asdict(operation) for operation in operations])
        return
    rows = [
        (o.name.partition("/")[2], o.kind, o.state, o.subject, o.attempts, o.failure_reason, o.failure_message)
        for o in operations
    ]
    count = f"{len(rows)} operation{'' if len(rows) == 1 else 's'}"
    emit_table(count, ("id", "kind", "state", "subject", "attempts", "reason", "message"), rows)
