"""`revisit loops NAME`: a person accepts or rejects a loop closure, or takes that back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from revisit.cli.output import emit_json, refuse, say
from revisit.cli.submap_names import short_name


def decide(map_id: str, name: str, decisions: Sequence[str], note: str, http: str, as_json: bool) -> None:
    """Make the one decision, accept, reject or revert, on a loop closure by its id or whole name."""
    if not name or len(decisions) != 1:
        raise refuse("give NAME with one of --accept, --reject and --revert")
    from revisit.sdk.client import Client

    whole = name if "/" in name else f"maps/{map_id}/loopClosures/{name}"
    with Client(http) as client:
        made = {
            "accept": client.accept_loop_closure,
            "reject": client.reject_loop_closure,
            "revert": client.revert_loop_closure,
        }
        decided = made[decisions[0]](whole, note=note)
    if as_json:
        emit_json(asdict(decided))
    else:
        say(f"{decided.name} is {decided.state}: {short_name(decided.query)} -> {short_name(decided.match)}")
