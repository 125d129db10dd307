"""A picture laid on the ground by two pins: scaled, turned and moved, never stretched or mirrored.

Pixels count from the upper left corner, to the right and down; x and y of the ground make a right-handed frame. As
complex numbers, with p = x_px - i y_px and z = x + i y: z = a p + b.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

Point = tuple[float, float]


@dataclass(frozen=True)
class PinnedPlane:
    """z = a p + b: |a| metres a pixel, turned counter-clockwise by the angle of a; pixel (0, 0) lies at b."""

    a: complex
    b: complex

    @classmethod
    def by(cls, pixels: tuple[Point, Point], ground: tuple[Point, Point]) -> PinnedPlane:
        """The plane on which two pixels lie at two points of the ground, metres. Raises ValueError for equal pixels."""
        (p, q), (y, z) = (complex(u, -v) for u, v in pixels), (complex(*at) for at in ground)
        if p == q:
            raise ValueError("two pins at one pixel hold no plane")
        a = (z - y) / (q - p)
        return cls(a, y - a * p)

    def at(self, pixel: Point) -> Point:
        """The ground under a pixel, metres."""
        z = self.a * complex(pixel[0], -pixel[1]) + self.b
        return z.real, z.imag

    @property
    def metres_per_pixel(self) -> float:
        """The scale."""
        return abs(self.a)

    @property
    def turn_rad(self) -> float:
        """The turn, counter-clockwise, -pi to pi."""
        return cmath.phase(self.a)
