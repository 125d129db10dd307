"""`revisit plans`: pictures underneath a map, each held by two pins."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.options import HTTP, Http, Json, Yes
from revisit.cli.output import confirm, counted, emit_json, emit_table, refuse, say

if TYPE_CHECKING:
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Plan

Pin = tuple[tuple[float, float], tuple[float, float]]

group = typer.Typer(help="Put floor plans and orthophotos under a map.", no_args_is_help=True)

MapId = Annotated[str, typer.Argument(metavar="MAP", help="Id of the map.")]
PlanId = Annotated[str, typer.Argument(metavar="ID", help="Id of the plan.")]
File = Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="PNG or JPEG.")]
Pins = Annotated[
    list[str],
    typer.Option("--pin", metavar="PX,PY=X,Y", help="A pixel of the picture and its place in the map, metres; two."),
]
OnEarth = Annotated[
    bool,
    typer.Option("--on-earth", help="Places of pins are latitude and longitude, degrees."),
]


@group.command("add")
def add(
    map_id: MapId,
    file: File,
    pins: Pins,
    plan_id: Annotated[str, typer.Option("--id", help="Id of the plan; that of the file otherwise.")] = "",
    display_name: Annotated[str, typer.Option("--name", help="Name for people.")] = "",
    storey: Annotated[str, typer.Option("--storey", help="The storey that it shows.")] = "",
    on_earth: OnEarth = False,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Put a picture under a map; the same one again is passed over."""
    from revisit.sdk.client import Client

    given, named = _pins(pins), plan_id or file.stem
    with Client(http) as client:
        given = _from_earth(client, map_id, given) if on_earth else given
        made = client.plans.create(map_id, named, file, given, display_name=display_name, storey=storey or None)
    _tell(made, json)


@group.command("pin")
def pin(
    map_id: MapId, plan_id: PlanId, pins: Pins, on_earth: OnEarth = False, http: Http = HTTP, json: Json = False
) -> None:
    """Hold a plan by two other pins."""
    from revisit.sdk.client import Client

    given = _pins(pins)
    with Client(http) as client:
        given = _from_earth(client, map_id, given) if on_earth else given
        _tell(client.plans.pin(_name(map_id, plan_id), given), json)


@group.command("list")
def list_plans(map_id: MapId, http: Http = HTTP, json: Json = False) -> None:
    """List the plans of a map."""
    from revisit.sdk.client import Client

    with Client(http) as client:
        found = client.plans.list(map_id)
    if json:
        emit_json([asdict(one) for one in found])
    else:
        emit_table(counted(len(found), "plan"), COLUMNS, [_row(one) for one in found])


@group.command("remove")
def remove(
    map_id: MapId,
    plan_ids: Annotated[list[str], typer.Argument(metavar="ID...", help="Those to remove.")],
    yes: Yes = False,
    http: Http = HTTP,
) -> None:
    """Remove plans with their pictures."""
    from revisit.sdk.client import Client

    confirm(f"Remove {counted(len(plan_ids), 'plan')} of map {map_id}?", yes)
    with Client(http) as client:
        for plan_id in plan_ids:
            client.plans.delete(_name(map_id, plan_id))
    say(f"Map {map_id} has lost {counted(len(plan_ids), 'plan')}.")


COLUMNS = ("plan", "name", "storey", "pixels", "m a pixel", "turned")


def _name(map_id: str, plan_id: str) -> str:
    return f"maps/{map_id}/plans/{plan_id}"


def _row(plan: Plan) -> tuple[Any, ...]:
    size, turned = f"{plan.width_px} x {plan.height_px}", f"{math.degrees(plan.turn_rad):.1f} deg"
    return plan.name.rpartition("/")[2], plan.display_name, plan.storey, size, f"{plan.metres_per_pixel:.4g}", turned


def _tell(plan: Plan, json: bool) -> None:
    if json:
        emit_json(asdict(plan))
        return
    turned = math.degrees(plan.turn_rad)
    say(f"{plan.name}: {plan.metres_per_pixel:.4g} m a pixel, turned by {turned:.1f} degrees counter-clockwise.")


def _from_earth(client: Client, map_id: str, pins: list[Pin]) -> list[Pin]:
    """Pins at latitudes and longitudes, in metres of the map. Exits where the map has not one frame on earth."""
    frames = client.maps.on_earth(map_id)
    if len(frames) != 1:
        raise refuse(f"map {map_id} has {counted(len(frames), 'frame')} on earth: --on-earth needs one")
    (earth,) = frames.values()
    return [(pixel, earth.place(*place)) for pixel, place in pins]


def _pins(texts: list[str]) -> list[Pin]:
    """The pins of PX,PY=X,Y. Exits where one is no pin."""
    return [(_point(pixel, text), _point(ground, text)) for text in texts for pixel, _, ground in [text.partition("=")]]


def _point(part: str, text: str) -> tuple[float, float]:
    try:
        x, y = (float(number) for number in part.split(","))
    except ValueError as error:
        raise refuse(f"a pin is PX,PY=X,Y, as 120,480=3.5,-2; got {text!r}") from error
    return x, y
