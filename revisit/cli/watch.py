"""`revisit watch`: the events of a map, a line each, as they happen."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from itertools import islice
from math import hypot
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import HTTP, Http, MapName
from revisit.cli.output import plain, refuse, say, signs

if TYPE_CHECKING:
    from revisit.sdk.resources import Anchor, DriveChanges, Event, LoopClosure, MapVersion, Operation, RetentionReport

KINDS = ("LOOP_CLOSURE", "OPERATION", "MAP_VERSION", "RETENTION", "ANCHOR", "MAP_CHANGED")


def watch(
    map_id: MapName = "default",
    after: Annotated[
        int | None, typer.Option(min=0, help="Begin behind this event; 0: with the oldest that is kept.")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option(help=f"{', '.join(KINDS[:-1])} or {KINDS[-1]}; may be given again.")
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="End after so many events.")] = None,
    http: Http = HTTP,
    json: Annotated[bool, typer.Option("--json", help="One JSON document a line.")] = False,
) -> None:
    """Print loop closures, operations, versions and anchors of a map as they happen, until Ctrl-C."""
    from revisit.sdk.client import Client

    kinds = [word.upper() for word in kind or ()]
    if unknown := [word for word in kinds if word not in KINDS]:
        raise refuse(f"--kind is one of {', '.join(KINDS)}, not {unknown[0]}")
    with Client(http) as client, suppress(KeyboardInterrupt):
        signs.doing(f"waiting for events of map {map_id}")
        events = client.watch(f"maps/{map_id}", after=after, kinds=kinds)
        for event in islice(events, count):
            for line in [_document(event)] if json else _sentences(event):
                say(line)


def _document(event: Event) -> str:
    return json_format.dumps(asdict(event), default=plain, allow_nan=False)


def _sentences(event: Event) -> Iterator[str]:
    number = f"{event.number:>8}  "
    if event.loop_closure is not None:
        yield number + _of_loop(event.loop_closure)
    elif event.operation is not None:
        yield number + _of_operation(event.operation)
    elif event.map_version is not None:
        yield number + _of_version(event.map_version)
    elif event.retention is not None:
        yield number + _of_retention(event.retention)
    elif event.anchor is not None:
        yield number + _of_anchor(event.anchor)
    elif event.drive_changes is not None:
        yield number + _of_changes(event.drive_changes)
    else:
        yield number + "earlier events are no longer kept: list again what is of interest"


def _of_loop(loop: LoopClosure) -> str:
    verdict = f"loop closure {loop.state.lower()}: {short_name(loop.query)} -> {short_name(loop.match)}"
    return f"{verdict}, {loop.reason}" if loop.reason else f"{verdict}, score {loop.score:.2f}"


def _of_operation(operation: Operation) -> str:
    said = f"{operation.kind.lower().replace('_', ' ')} {operation.state.lower()}: {short_name(operation.subject)}"
    return f"{said}, {operation.failure_reason}: {operation.failure_message}" if operation.failure_reason else said


def _of_version(version: MapVersion) -> str:
    of = version.summary
    back = f" with the poses of version {version.restored_from}" if version.restored_from else ""
    return f"map version {version.version}{back}: {of.submaps} submaps, {of.loops_in_map} loop closures hold it"


def _of_retention(report: RetentionReport) -> str:
    freed = sum(one.bytes for one in report.rules)
    return f"retention has removed {1e-6 * freed:.1f} MB by {', '.join(one.rule for one in report.rules)}"


_OF_ANCHORS = {"IN_MAP": "holds the map", "SET_ASIDE": "set aside", "NOT_ALIGNED": "has no effect"}


def _of_anchor(anchor: Anchor) -> str:
    said = _OF_ANCHORS.get(anchor.state or "", "is not judged")
    off = "" if anchor.residual_m is None else f", {hypot(*anchor.residual_m):.2f} m off"
    return f"anchor {said}: {short_name(anchor.name)}{off}{f', {anchor.reason}' if anchor.reason else ''}"


def _of_changes(changes: DriveChanges) -> str:
    found = {"appeared": changes.appeared, "vanished": changes.vanished, "moved": changes.moved, "back": changes.back}
    return (
        f"{short_name(changes.session)} found {', '.join(f'{count} {kind}' for kind, count in found.items() if count)}"
    )


def short_name(name: str) -> str:
    """A resource name without the names of its collections and its map: `monday/m2`; a map's id for a map."""
    ids = name.split("/")[1::2]
    return "/".join(ids[1:] or ids)
