"""Groups in order of arrival, and sums that do not depend on order, by torch.

A device does not go through returns one after another. Sorting takes the place of a loop: stable
sorts keep the order of equals. Sums are of whole numbers, whose order does not matter, so that they are the same
on each device and in each run.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_LARGEST_KEY = 2.0**62


@dataclass(frozen=True)
class VoxelKeys:
    """One whole number for each voxel of a box, in the order x, y, z: `low` (3,) is its least one, `shape` its size."""

    low: Tensor
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, voxels: Tensor, margin: int = 0) -> VoxelKeys | None:
        """The keys of the box around `voxels` (n, 3), and `margin` voxels more; None where it has too many."""
        low = voxels.amin(0) - margin
        x, y, z = (voxels.amax(0) + margin - low + 1).tolist()
        return cls(low, (x, y, z)) if float(x) * float(y) * float(z) < _LARGEST_KEY else None

    def __call__(self, voxels: Tensor) -> Tensor:
        """The keys (...) of `voxels` (..., 3) in the box."""
        x, y, z = (voxels - self.low).unbind(-1)
        return (x * self.shape[1] + y) * self.shape[2] + z

    def voxels(self, keys: Tensor) -> Tensor:
        """The voxels (..., 3) of `keys` (...)."""
        column, z = keys // self.shape[2], keys % self.shape[2]
        return torch.stack([column // self.shape[1], column % self.shape[1], z], dim=-1) + self.low


def voxels_of(positions: Tensor, resolution: float) -> Tensor:
    """The voxels (..., 3) int64 of edge `resolution` in which `positions` (..., 3) lie."""
    return torch.floor(positions.double() / resolution).long()


def first_seen(keys: Tensor) -> tuple[Tensor, Tensor]:
    """The distinct `keys` (n,) in the order in which each is first there: the number (n,) of each key among them, and
    the row (m,) where each is first.
    """
    ordered, order = torch.sort(keys, stable=True)
    new = torch.ones_like(ordered, dtype=torch.bool)
    new[1:] = ordered[1:] != ordered[:-1]
    first, appearance = torch.sort(order[new])
    rank = torch.empty_like(appearance)
    rank[appearance] = torch.arange(len(appearance), device=keys.device)
    numbers = torch.empty_like(keys)
    numbers[order] = rank[torch.cumsum(new, 0) - 1]
    return numbers, first


def root(squared: Tensor) -> Tensor:
    """The square roots of `squared`, 32 bits, rounded right: torch's own are not on every device."""
    return torch.sqrt(squared.double()).float()


@dataclass(frozen=True)
class Groups:
    """Which rows belong together: the group (n,) of each, and how many rows (m,) each group has.

    Nothing here waits for the device.
    """

    rows: Tensor
    sizes: Tensor

    @classmethod
    def of(cls, rows: Tensor, count: int) -> Groups:
        """`count` groups, of which `rows` (n,) are the numbers."""
        sizes = torch.zeros(count, dtype=torch.int64, device=rows.device)
        return cls(rows, sizes.index_add_(0, rows, torch.ones_like(rows)))

    def sums(self, values: Tensor, greatest: float | Tensor) -> Tensor:
        """Sums (m, ...) float64 of `values` (n, ...) by group, in any order; none exceeds `greatest`.

        Values are rounded to whole multiples of a power of two, so small that the sum of most values fits into 62 bits.
        """
        most = self.sizes.amax() if len(self.sizes) else self.sizes.sum()
        unit = _power_of_two(_bits(most) + _bits(torch.zeros((), device=most.device).double() + greatest) - 61)
        whole = torch.round(values.double() / unit).long()
        sums = torch.zeros((len(self.sizes), *values.shape[1:]), dtype=torch.int64, device=values.device)
        return sums.index_add_(0, self.rows, whole).double() * unit


def _bits(number: Tensor) -> Tensor:
    """The least whole e with `number` < 2^e."""
    return torch.frexp(number.double()).exponent.long()


def _power_of_two(exponent: Tensor) -> Tensor:
    """2^`exponent`, exactly, float64."""
    return ((exponent + 1_023) << 52).view(torch.float64)


def ranges(first: Tensor, count: Tensor) -> tuple[Tensor, Tensor]:
    """All rows of ranges that begin at `first` (n,) and have `count` (n,) rows, end to end: range and row of each."""
    ends = torch.cumsum(count, 0)
    owners = torch.repeat_interleave(count, output_size=int(ends[-1]) if len(ends) else 0)
    rows = torch.arange(len(owners), device=count.device) + (first - ends + count)[owners]
    return owners, rows
