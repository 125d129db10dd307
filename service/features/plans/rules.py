"""Pins of a plan: which are taken, how they are kept, and where they are once a submap has moved.

A pin goes with the submap that was nearest to it when it was set: where a loop closure bends the map, the corner of a
building moves, and the plan with it (docs/decisions/0334).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from revisit.core.errors import BadField
from revisit.core.geometry.pinned_plane import PinnedPlane
from revisit.core.geometry.se3 import Matrix4
from revisit.service.domain import limits
from revisit.service.domain.records import PlanRecord


@dataclass(frozen=True)
class PlanPin:
    """A point of a picture, pixels, and its place in the frame of its plan, metres."""

    pixel_x: float
    pixel_y: float
    x_m: float
    y_m: float

    @property
    def pixel(self) -> tuple[float, float]:
        """(2,)."""
        return self.pixel_x, self.pixel_y

    @property
    def ground(self) -> tuple[float, float]:
        """(2,), metres."""
        return self.x_m, self.y_m

    def validated(self) -> PlanPin:
        """Raises BadField."""
        for name in ("pixel_x", "pixel_y"):
            limits.PLAN_PIXEL.validated(getattr(self, name), f"pins.{name}")
        for name in ("x_m", "y_m"):
            limits.PLAN_COORDINATE_M.validated(getattr(self, name), f"pins.{name}")
        return self


@dataclass(frozen=True)
class HeldPin:
    """A pin as it was set, and where it is in the frame of the submap of this number, metres; 0 for none."""

    pin: PlanPin
    submap: int = 0
    in_submap: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def row(self) -> tuple[float, ...]:
        """Eight numbers."""
        return (*self.pin.pixel, *self.pin.ground, self.submap, *self.in_submap)

    @classmethod
    def of(cls, row: Sequence[float]) -> HeldPin:
        """See `row`."""
        x, y, z = row[5:]
        return cls(PlanPin(*row[:4]), int(row[4]), (x, y, z))

    def moved(self, T_map_submap: Matrix4) -> PlanPin:
        """The pin where its submap lies now."""
        x, y = (T_map_submap[:2] @ [*self.in_submap, 1.0]).tolist()
        return PlanPin(*self.pin.pixel, x, y)


@dataclass(frozen=True)
class PlanView:
    """A plan with its two pins where they are by a version of the map, 0 for none."""

    record: PlanRecord
    pins: tuple[PlanPin, PlanPin]
    frame: str
    map_version: int

    @property
    def number(self) -> int:
        """That of the row."""
        return self.record.number

    @property
    def plane(self) -> PinnedPlane:
        """How the picture lies on the ground."""
        return plane_of(self.pins)


def plane_of(pins: tuple[PlanPin, PlanPin]) -> PinnedPlane:
    """How a picture with these pins lies on the ground."""
    first, second = pins
    return PinnedPlane.by((first.pixel, second.pixel), (first.ground, second.ground))


def two_pins(sent: Sequence[PlanPin], width_px: int, height_px: int) -> tuple[PlanPin, PlanPin]:
    """The pins of a picture. Raises BadField where they are not two, lie beside it, or coincide."""
    if len(sent) != 2:
        raise BadField(f"a plan has two pins, got {len(sent)}", field="pins")
    first, second = (pin.validated() for pin in sent)
    if any(pin.pixel_x > width_px or pin.pixel_y > height_px for pin in (first, second)):
        raise BadField(f"a pin lies outside of the picture of {width_px} x {height_px} pixels", field="pins")
    if math.dist(first.pixel, second.pixel) < limits.PLAN_PINS_APART:
        raise BadField("the two pins are at one point of the picture: set them far from each other", field="pins")
    scale = plane_of((first, second)).metres_per_pixel
    if scale not in limits.PLAN_METRES_PER_PIXEL:
        message = f"these pins make a pixel {scale:.3g} m large, which must be in {limits.PLAN_METRES_PER_PIXEL}"
        raise BadField(message, field="pins")
    return first, second
