"""Paths over ground: polylines by arc length, street grids, and the streets under a recorded drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from revisit.evaluation.simulator.blocks import Floats


@dataclass(frozen=True)
class Path:
    """A polyline over ground. points (n, 2) metres, arc (n,) metres from its start, strictly increasing."""

    points: Floats
    arc: Floats

    @classmethod
    def through(cls, points: ArrayLike) -> Path:
        """The path through `points` (n >= 2, 2 or 3; the height is ignored); repeated points are dropped."""
        flat = np.asarray(points, dtype=np.float64)[:, :2]
        moved = np.concatenate([[True], np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-6])
        flat = flat[moved]
        if len(flat) < 2:
            raise ValueError("a path needs two different points")
        steps = np.linalg.norm(np.diff(flat, axis=0), axis=1)
        return cls(flat, np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def length(self) -> float:
        """Metres from start to end."""
        return float(self.arc[-1])

    def at(self, arc: ArrayLike) -> Floats:
        """Positions (n, 2) at the arc lengths (n,)."""
        s = np.asarray(arc, dtype=np.float64)
        return np.stack([np.interp(s, self.arc, self.points[:, 0]), np.interp(s, self.arc, self.points[:, 1])], axis=-1)

    def heading(self, arc: ArrayLike, span: float = 1.0) -> Floats:
        """Directions of travel (n,) in radians at the arc lengths, over `span` metres."""
        s = np.asarray(arc, dtype=np.float64)
        step = self.at(np.minimum(s + span / 2, self.length)) - self.at(np.maximum(s - span / 2, 0.0))
        return np.asarray(np.arctan2(step[..., 1], step[..., 0]))

    def beside(self, arc: ArrayLike, left: ArrayLike) -> Floats:
        """Positions (n, 2) `left` metres to the left of the path (negative: to the right)."""
        yaw = self.heading(arc)
        return np.asarray(self.at(arc) + np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1) * np.asarray(left)[..., None])

    def sampled(self, spacing: float) -> Path:
        """The same path with a point about every `spacing` metres."""
        count = max(2, int(np.ceil(self.length / spacing)) + 1)
        return Path.through(self.at(np.linspace(0.0, self.length, count)))

    def rounded(self, radius: float) -> Path:
        """The path with corners smoothed over about `radius` metres, its ends kept."""
        dense = self.sampled(0.5)
        width = max(1, round(radius / 0.5))
        padded = np.pad(dense.points, ((width, width), (0, 0)), mode="edge")
        kernel = np.ones(2 * width + 1) / (2 * width + 1)
        smooth = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
        smooth[0], smooth[-1] = dense.points[0], dense.points[-1]
        return Path.through(smooth)


@dataclass(frozen=True)
class StreetGrid:
    """Streets of a planned town. xs (a,) and ys (b,) are where the streets along y and along x run, metres."""

    xs: Floats
    ys: Floats

    @classmethod
    def random(cls, streets_x: int, streets_y: int, seed: int, block_m: float = 85.0) -> StreetGrid:
        """A grid of `streets_x` by `streets_y` streets, blocks of random size: `block_m` metres, give or take 30 %."""
        rng = np.random.default_rng([seed, 11])
        gaps_x = block_m * rng.uniform(0.7, 1.3, streets_x - 1)
        gaps_y = block_m * rng.uniform(0.7, 1.3, streets_y - 1)
        return cls(np.concatenate([[0.0], np.cumsum(gaps_x)]), np.concatenate([[0.0], np.cumsum(gaps_y)]))

    def streets(self, overhang: float = 40.0) -> list[Path]:
        """One path a street, `overhang` metres longer at both ends."""
        low_x, high_x = self.xs[0] - overhang, self.xs[-1] + overhang
        low_y, high_y = self.ys[0] - overhang, self.ys[-1] + overhang
        along_y = [Path.through([[x, low_y], [x, high_y]]) for x in self.xs]
        return along_y + [Path.through([[low_x, y], [high_x, y]]) for y in self.ys]

    def crossing(self, column: int, row: int) -> tuple[float, float]:
        """Position of the crossing of street `column` along y and street `row` along x."""
        return float(self.xs[column]), float(self.ys[row])

    def route(self, crossings: list[tuple[int, int]]) -> Path:
        """The way over the given crossings along street centres."""
        return Path.through([self.crossing(column, row) for column, row in crossings])
