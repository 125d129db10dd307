"""spool: what waits on this machine, and what the service would not take."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from revisit.cli.output import emit_json, emit_table
from revisit.sdk.client import Client
from revisit.sdk.spool import Spool


def show(file: Path, send_to: str | None, as_json: bool) -> None:
    """Print the spool's state and dead letters; before that send what it holds to `send_to`, where given."""
    spool = Spool(file)
    state, dead = spool.state, spool.dead_letters()
    spool.close()
    if send_to is not None and state.pending:
        with Client.grpc(send_to) as client, client.spooled_stream(state.session, file) as stream:
            stream.flush()
            state, dead = stream.state, stream.dead_letters
    if as_json:
        emit_json({**asdict(state), "dead_letters": [asdict(letter) for letter in dead]})
        return
    emit_table("Spool", ("what", "value"), asdict(state).items())
    if dead:
        rows = [(letter.seq, letter.stamp_ns, letter.reason, letter.message) for letter in dead]
        emit_table("Refused scans", ("seq", "stamp_ns", "reason", "message"), rows)
