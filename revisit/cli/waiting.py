"""Waiting for an operation, with how far it has come on stderr."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from revisit.api.words import NO_WORKER
from revisit.cli.output import progress_bar, tell

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Operation

POLL_S = 1.0
"""How often a person sees how an operation stands."""


def teller_of_no_worker(client: Client) -> Callable[[], None]:
    """Looks, at its first call, whether a worker is ready, and says on stderr where none is."""
    looked = False

    def look() -> None:
        nonlocal looked
        if not looked and not client.status().workers:
            tell(f"revisit: {NO_WORKER}; this waits, and goes on by itself")
        looked = True

    return look


def waited(client: Client, operation: Operation, *, quiet: bool) -> Operation:
    """The operation once it is done."""
    look = teller_of_no_worker(client)
    with progress_bar(quiet) as bar:
        task = bar.add_task("QUEUED", total=1)
        while True:
            try:
                done = client.wait(operation, POLL_S)
            except TimeoutError:
                look()
                current = client.get_operation(operation.name)
                stands = current.progress
                if stands is None:
                    bar.update(task, description=current.state)
                else:
                    bar.update(task, description=stands.stage, completed=stands.done, total=stands.total)
                continue
            bar.update(task, description="DONE", completed=1, total=1)
            return done
