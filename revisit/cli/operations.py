"""`revisit operations`: the work of the service, and the way of failed work back into its queue."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import HTTP, Http, Json
from revisit.cli.output import counted, emit_json, emit_table, refuse

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Operation

STATES = ("QUEUED", "RUNNING", "DONE", "FAILED", "ALL")


def operations(
    names: Annotated[list[str] | None, typer.Argument(help="Ids, of those to retry or to cancel.")] = None,
    state: Annotated[str, typer.Option(help="QUEUED, RUNNING, DONE, FAILED or ALL.")] = "FAILED",
    retry: Annotated[
        bool, typer.Option("--retry", help="Queue these failed descriptions again, with as many attempts as new ones.")
    ] = False,
    cancel: Annotated[
        bool, typer.Option("--cancel", help="End these optimisations or merges: at once, or at their next step.")
    ] = False,
    every: Annotated[bool, typer.Option("--all", help="With --retry: every description that has failed.")] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """List operations with their subjects and reasons of failure, by default those that failed for good.

    With --retry or --cancel: those named.
    """
    from revisit.sdk.client import Client

    if state.upper() not in STATES:
        raise refuse(f"--state is one of {', '.join(STATES)}")
    _require_one_way(names, retry=retry, cancel=cancel, every=every)
    given = [f"operations/{one.removeprefix('operations/')}" for one in names or []]
    with Client(http) as client:
        if retry:
            _emit([client.retry_operation(name) for name in given or _failed_descriptions(client)], json)
        elif cancel:
            _emit([client.cancel_operation(name) for name in given], json)
        else:
            _emit(client.list_operations(state=None if state.upper() == "ALL" else state.upper()), json)


def _require_one_way(names: list[str] | None, *, retry: bool, cancel: bool, every: bool) -> None:
    """Exits unless it is a list, or a retry or a cancellation of named operations."""
    listing = not (names or retry or cancel or every)
    retrying = retry and not cancel and every != bool(names)
    cancelling = cancel and not retry and not every and bool(names)
    if not (listing or retrying or cancelling):
        raise refuse("give --retry with ids or --all, or --cancel with ids")


def _failed_descriptions(client: Client) -> list[str]:
    return [one.name for one in client.list_operations(state="FAILED") if one.kind == "DESCRIBE_SUBMAP"]


def _emit(operations: list[Operation], as_json: bool) -> None:
    if as_json:
        emit_json([asdict(operation) for operation in operations])
        return
    rows = [
        (o.name.partition("/")[2], o.kind, o.state, o.subject, o.attempts, o.failure_reason, o.failure_message)
        for o in operations
    ]
    emit_table(
        counted(len(rows), "operation"), ("id", "kind", "state", "subject", "attempts", "reason", "message"), rows
    )
