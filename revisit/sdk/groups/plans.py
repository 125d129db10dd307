"""Plans: pictures underneath a map."""

from __future__ import annotations

import builtins
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from revisit.sdk import names
from revisit.sdk.groups.group import Group
from revisit.sdk.messages import request_of
from revisit.sdk.names import name_of
from revisit.sdk.resources import Map, Plan
from revisit.v1 import plan_pb2


class Plans(Group):
    """`client.plans`.

    A pin is a pair: a point of the picture, pixels from its left and its upper edge, and the place of that point in the
    map, x and y in metres: `((120, 480), (3.5, -2.0))`. A plan has two.
    """

    def create(
        self,
        map_: str | Map,
        plan_id: str,
        image: Path | str | bytes,
        pins: Iterable[tuple[tuple[float, float], tuple[float, float]]],
        *,
        display_name: str = "",
        storey: str | None = None,
    ) -> Plan:
        """Put a picture, PNG or JPEG, underneath a map: `image` is its file, or the bytes of one.

        `storey` is the storey of a building that it shows, as sessions name theirs.
        """
        data: bytes = image if isinstance(image, bytes) else Path(image).read_bytes()
        said = {"plan_id": plan_id, "display_name": display_name, "storey": storey}
        parent = name_of(map_, names.MAP)
        return Plan.of(self._ask("CreatePlan", parent=parent, image=data, pins=_pins(pins), **said))

    def get(self, plan: str | Plan) -> Plan:
        """Get `maps/{map}/plans/{plan}`, its pins where the version in force has them."""
        return Plan.of(self._ask("GetPlan", name=name_of(plan, names.PLAN)))

    def list(self, map_: str | Map) -> builtins.list[Plan]:
        """The plans of a map, oldest first."""
        return self._list(Plan, "ListPlans", parent=name_of(map_, names.MAP))

    def pin(self, plan: str | Plan, pins: Iterable[tuple[tuple[float, float], tuple[float, float]]]) -> Plan:
        """Hold a plan by two other pins."""
        return Plan.of(self._ask("PinPlan", name=name_of(plan, names.PLAN), pins=_pins(pins)))

    def delete(self, plan: str | Plan) -> None:
        """Delete a plan with its picture."""
        self._ask("DeletePlan", name=name_of(plan, names.PLAN))

    def download(self, plan: str | Plan) -> bytes:
        """The picture as it was sent."""
        asked = {"name": name_of(plan, names.PLAN)}
        return self._transport.download("DownloadPlan", request_of(plan_pb2.DownloadPlanRequest, asked))


def _pins(pins: Iterable[tuple[tuple[float, float], tuple[float, float]]]) -> Any:
    """The pins of a request."""
    made = []
    for (pixel_x, pixel_y), (x_m, y_m) in pins:
        made.append({"pixel_x": float(pixel_x), "pixel_y": float(pixel_y), "x_m": float(x_m), "y_m": float(y_m)})
    return made
