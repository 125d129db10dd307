"""`revisit plan`: what a fleet takes, from measured constants, and where each choice ends."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import Json
from revisit.cli.output import emit_json, emit_table, refuse, say

if TYPE_CHECKING:
    from revisit.cli.sizing import Fleet, Limit, Need
    from revisit.service.domain.retention import RetentionPolicy


def plan(
    robots: Annotated[int, typer.Option(min=1, help="Robots that drive at the same time.")] = 1,
    beams: Annotated[int, typer.Option(min=1, max=256, help="Beams of their lidars.")] = 64,
    hz: Annotated[
        float | None,
        typer.Option(min=0.01, max=100.0, help="Scans a second that a robot sends; by default the described ones."),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=50.0, help="Metres a second.")] = 1.0,
    hours: Annotated[float, typer.Option(min=0.1, max=24.0, help="Hours a day that they drive.")] = 24.0,
    days: Annotated[float, typer.Option(min=1.0, max=36500.0, help="Days after which the disk is looked at.")] = 30.0,
    retention: Annotated[str, typer.Option(help="What is kept, as `revisit map retention --set` takes it.")] = "",
    cores: Annotated[int, typer.Option(min=1, help="Cores of a machine.")] = 16,
    disk_tb: Annotated[float, typer.Option("--disk-tb", min=0.001, max=1e6, help="Terabytes of its disk.")] = 4.0,
    json: Json = False,
) -> None:
    """Print the cores, memory, disk, rows and network that a fleet takes, and where each choice ends."""
    from revisit.cli.sizing import Fleet, constants, described_hz, limits_of, need_of

    fleet = Fleet(robots, beams, hz or described_hz(beams, speed), speed, hours, days, _policy(retention))
    need = need_of(fleet)
    limits = limits_of(need, cores, disk_tb)
    if json:
        ends = [{**asdict(one), "holds": one.holds} for one in limits]
        emit_json({"need": asdict(need), "limits": ends, "constants": constants()})
    else:
        _show(fleet, need, limits)


def _policy(text: str) -> RetentionPolicy:
    """The policy that the words say. Exits where they say none."""
    from revisit.core.errors import BadField
    from revisit.service.domain.retention import parsed

    try:
        return parsed(text)
    except BadField as error:
        raise refuse(error.message) from error


def _show(fleet: Fleet, need: Need, limits: list[Limit]) -> None:
    rows = [
        ("submaps, scans a second", f"{need.submaps_s:.2f}, {need.scans_s:.1f}"),
        ("cores of workers / gateways", f"{need.worker_cores:.2f} / {need.gateway_cores:.2f}"),
        ("memory", f"{need.memory_mib / 1024:.1f} GiB"),
        ("row writes a second", f"{need.row_writes_s:.0f}"),
        ("network to the service", f"{need.network_mbit_s:.1f} Mbit/s"),
        ("disk a day, before retention", f"{1e-9 * need.disk_bytes_a_day:.1f} GB"),
        (f"disk after {fleet.days:g} days", f"{1e-9 * sum(need.disk_bytes.values()):.1f} GB"),
        *((f"  {part}", f"{1e-9 * size:.1f} GB") for part, size in need.disk_bytes.items()),
    ]
    title = f"{fleet.robots} robots, {fleet.beams} beams, {fleet.hz:g} Hz, {fleet.speed_m_s:g} m/s"
    emit_table(title, ("what", "figure"), rows)
    ends = [
        (one.choice, f"{one.load:.3g} of {one.most:.3g} {one.unit}", "holds" if one.holds else f"ends: {one.then}")
        for one in limits
    ]
    emit_table("Where each choice ends", ("choice", "load", "and then"), ends)
    say("Constants were measured one by one, many on simulated drives; --json has command, date and machine of each.")
