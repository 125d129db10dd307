"""operations: what the workers have to do, what has failed for good, and its way back into the queue."""

from __future__ import annotations

from dataclasses import asdict

from revisit.cli.output import emit_json, emit_table, refuse
from revisit.sdk.client import Client
from revisit.sdk.resources import Operation

STATES = ("QUEUED", "RUNNING", "DONE", "FAILED", "ALL")


def list_operations(http: str, state: str, as_json: bool) -> None:
    """List the operations in a state."""
    if state not in STATES:
        raise refuse(f"--state is one of {', '.join(STATES)}")
    with Client(http) as client:
        _emit(client.list_operations(state=None if state == "ALL" else state), as_json)


def retry(http: str, ids: list[str], every: bool, as_json: bool) -> None:
    """Queue operations again: those of `ids`, or every failed description."""
    if every == bool(ids):
        raise refuse("give either ids or --all")
    with Client(http) as client:
        failed = client.list_operations(state="FAILED") if every else []
        names = [operation.name for operation in failed if operation.kind == "DESCRIBE_SUBMAP"]
        names += [f"operations/{given.removeprefix('operations/')}" for given in ids]
        _emit([client.retry_operation(name) for name in names], as_json)


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
