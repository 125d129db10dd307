"""`revisit map retention`: what a map keeps, what that would remove, and what it has removed."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import HTTP, Http, Json, MapName
from revisit.cli.output import emit_json, emit_table, refuse, say, utc

if TYPE_CHECKING:
    from revisit.sdk.resources import MapRetention, RetentionPolicy, RetentionReport


def retention(
    map_id: MapName = "default",
    policy: Annotated[
        str | None,
        typer.Option(
            "--set",
            help="The policy from now on, words separated by commas: scans=all|described|none|24h, best=2, "
            "sessions=90d, dropped=7d, rejected=30d, retired=30d; what it removes does not come back.",
        ),
    ] = None,
    of_service: Annotated[bool, typer.Option("--unset", help="From now on the policy of the service.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="What the policy, or that of --set, would remove now; changes nothing.")
    ] = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Show what a map keeps of its scans, submaps and sessions, for how long, and what was removed last; or set it."""
    from revisit.sdk.client import Client

    if of_service and (policy is not None or dry_run):
        raise refuse("give --unset alone")
    asked, name = None if policy is None else _policy(policy), f"maps/{map_id}"
    with Client(http) as client:
        if dry_run:
            _emit_report(client.preview_retention(name, asked), "Would be removed", json)
        elif asked is not None or of_service:
            _emit(client.set_retention(name, asked), json)
        else:
            _emit(client.retention(name), json)


def _policy(text: str) -> RetentionPolicy:
    """The policy that the words say. Exits where they say none."""
    from revisit.core.errors import BadField
    from revisit.sdk.resources import RetentionPolicy
    from revisit.service.domain.retention import parsed

    try:
        return RetentionPolicy(**asdict(parsed(text)))
    except BadField as error:
        raise refuse(error.message) from error


def _emit(kept: MapRetention, as_json: bool) -> None:
    from revisit.service.domain.retention import KeptScans
    from revisit.service.domain.retention import RetentionPolicy as Words

    if as_json:
        emit_json(asdict(kept))
        return
    fields = asdict(kept.policy)
    words = str(Words(**{**fields, "keep_scans": KeptScans(fields["keep_scans"])})) or "everything is kept"
    say(f"{kept.map}: {words} ({'its own policy' if kept.own else 'the policy of the service'}).")
    if kept.redescription == "FROM_NEURAL_MAPS":
        say("A later model describes its submaps from their neural maps alone: their scans are not kept.")
    if kept.last_run is not None:
        _emit_report(kept.last_run, f"Removed last, {utc(kept.last_run.at_ns)}", as_json=False)


def _emit_report(report: RetentionReport, title: str, as_json: bool) -> None:
    if as_json:
        emit_json(asdict(report))
        return
    rows = [
        (
            one.rule.lower().replace("_", " "),
            one.sessions,
            one.submaps,
            one.scans,
            one.loop_closures,
            f"{1e-6 * one.bytes:.1f}",
        )
        for one in report.rules
    ]
    emit_table(title, ("rule", "sessions", "submaps", "scans", "pairs", "MB"), rows)
    if report.submaps_held or report.sessions_held:
        say(
            f"Held: {report.submaps_held} submaps with a loop closure to decide on, {report.sessions_held} sessions "
            "that the map rests on."
        )
