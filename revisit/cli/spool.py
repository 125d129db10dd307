"""`revisit spool`: the scans that wait on this machine, and those that the service refused."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from revisit.cli.options import GRPC, HTTP, Grpc, Http, Json
from revisit.cli.output import emit_json, emit_table


def spool(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="The spool.")],
    send: Annotated[bool, typer.Option(help="Send what it holds first.")] = False,
    http: Http = HTTP,
    grpc: Grpc = GRPC,
    json: Json = False,
) -> None:
    """Show the content of a robot's spool and the scans that the service refused; --send empties it first."""
    from revisit.sdk.client import Client
    from revisit.sdk.spool import Spool

    opened = Spool(file)
    state, dead = opened.state, opened.dead_letters()
    opened.close()
    if send and state.pending:
        with Client.grpc(grpc, http=http) as client, client.spooled_stream(state.session, file) as stream:
            stream.flush()
            state, dead = stream.state, stream.dead_letters
    if json:
        emit_json({**asdict(state), "dead_letters": [asdict(letter) for letter in dead]})
        return
    emit_table("Spool", ("what", "value"), asdict(state).items())
    if dead:
        rows = [(letter.seq, letter.stamp_ns, letter.reason, letter.message) for letter in dead]
        emit_table("Refused scans", ("seq", "stamp_ns", "reason", "message"), rows)
