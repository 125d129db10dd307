"""The kernels that a device may do in the place of the compiled ones, and what they are asked for.

A call takes many jobs under the same rules, so that a device does them as one. Jobs and answers are NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # brings the compiler
    from revisit.core.kernels.patches import Patches

Array64 = NDArray[np.float64]


class AlignmentRules(NamedTuple):
    """How ICP goes: as the arguments of `kernels.surface_alignment.aligned`."""

    edge: float
    reach: float
    rounds: int
    facing_alike: float
    robust: float
    fewest: int


class Alignment(NamedTuple):
    """Points (n, 3) with unit normals (n, 3), float64, and where ICP begins to bring them onto `patches`: (4, 4)."""

    T_start: Array64
    points: Array64
    normals: Array64
    patches: Patches


class ContactRules(NamedTuple):
    """What counts as contact: as the arguments of `kernels.surface_contact.contact_sums`."""

    edge: float
    reach: float
    plane_distance: float
    facing_alike: float
    column_edge: float


class Contact(NamedTuple):
    """A surface that is moved by `T_other_points` (4, 4) onto `patches`, whose seen columns are `slots` (s, 2).

    Of the points (n, 3) with unit normals (n, 3), float64, the first `standing` are off the ground.
    """

    points: Array64
    normals: Array64
    standing: int
    T_other_points: Array64
    patches: Patches
    slots: NDArray[np.int32]


class ContactNumbers(NamedTuple):
    """counts (3,), squares and information (6, 6) as of `kernels.surface_contact.contact_sums`."""

    counts: NDArray[np.int64]
    squares: float
    information: Array64


class Shifts(NamedTuple):
    """A surface in the frame of `patches`, and the moves (s, 3) that are tried with it; the rest as of `Contact`."""

    points: Array64
    normals: Array64
    shifts: Array64
    patches: Patches
    slots: NDArray[np.int32]


class Correlation(NamedTuple):
    """What stands, seen from above (n, 2) float64; the yaws at which it is compared, and the spectrum of the other."""

    points: Array64
    yaws: tuple[float, ...]
    spectrum: NDArray[np.complexfloating]


@dataclass(frozen=True)
class Agreement:
    """How well an image that was turned fits another one: the largest correlation over all shifts, divided by the norm
    of the turned image; the yaw; and the shift (2,), x and y in pixels.
    """

    peak: float
    yaw: float
    shift: Array64


class Kernels(Protocol):
    """What most of the time of verification goes into. The answers come in the order of the jobs."""

    def align(self, jobs: Sequence[Alignment], rules: AlignmentRules) -> list[Array64]:
        """For each job T (4, 4) after ICP, as `kernels.surface_alignment.aligned`."""
        ...

    def touch(self, jobs: Sequence[Contact], rules: ContactRules) -> list[ContactNumbers]:
        """For each job what the surfaces have in common, as `kernels.surface_contact.contact_sums`."""
        ...

    def share(self, jobs: Sequence[Shifts], rules: ContactRules) -> list[NDArray[np.int64]]:
        """For each job (s, 2): points in seen columns, and touching, as `kernels.surface_contact.shared_counts`."""
        ...

    def correlate(self, jobs: Sequence[Correlation], pixel: float) -> list[list[Agreement]]:
        """For each job and each of its yaws the best shift, and that for half a turn more (phase correlation)."""
        ...
