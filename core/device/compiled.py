"""The kernels of the processor: compiled, one job after another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from revisit.core.device.contract import (
    Agreement,
    Alignment,
    AlignmentRules,
    Array64,
    Contact,
    ContactNumbers,
    ContactRules,
    Correlation,
    Shifts,
)
from revisit.core.kernels.plan_images import plan_density
from revisit.core.kernels.surface_alignment import aligned
from revisit.core.kernels.surface_contact import contact_sums, shared_counts


class CompiledKernels:
    """`Kernels` by the functions of `core.kernels`."""

    def align(self, jobs: Sequence[Alignment], rules: AlignmentRules) -> list[Array64]:
        """See `Kernels`."""
        return [
            aligned(
                job.T_start, job.points, job.normals, job.patches, rules.edge, rules.reach, rules.rounds,
                rules.facing_alike, rules.robust, rules.fewest,
            )
            for job in jobs
        ]  # fmt: skip

    def touch(self, jobs: Sequence[Contact], rules: ContactRules) -> list[ContactNumbers]:
        """See `Kernels`."""
        found = [
            contact_sums(
                job.points, job.normals, job.standing, job.T_other_points, job.patches, rules.edge, rules.reach,
                rules.plane_distance, rules.facing_alike, job.slots, rules.column_edge,
            )
            for job in jobs
        ]  # fmt: skip
        return [ContactNumbers(*numbers) for numbers in found]

    def share(self, jobs: Sequence[Shifts], rules: ContactRules) -> list[NDArray[np.int64]]:
        """See `Kernels`."""
        return [
            shared_counts(
                job.points, job.normals, job.shifts, job.patches, rules.edge, rules.reach, rules.plane_distance,
                rules.facing_alike, job.slots, rules.column_edge,
            )
            for job in jobs
        ]  # fmt: skip

    def correlate(self, jobs: Sequence[Correlation], pixel: float) -> list[list[Agreement]]:
        """See `Kernels`."""
        return [_agreements(job, pixel) for job in jobs]


def _agreements(job: Correlation, pixel: float) -> list[Agreement]:
    size, found = len(job.spectrum), []
    for yaw in job.yaws:
        image = plan_density(job.points, yaw, pixel, size)
        norm = max(float(np.linalg.norm(image)), 1e-12)
        spectrum = fft.rfft2(image.astype(np.float32))
        for half_turn in (False, True):
            peak, shift = _best_shift(spectrum, job.spectrum, half_turn)
            found.append(Agreement(peak / norm, yaw + np.pi * half_turn, shift))
    return found


def _best_shift(
    spectrum: NDArray[np.complexfloating], other: NDArray[np.complexfloating], half_turn: bool
) -> tuple[float, Array64]:
    """The largest correlation of an image with the other, and the shift (x, y) in pixels that gives it.

    With `half_turn` the image is turned by 180 degrees first: its spectrum is then the conjugate, but for a pixel.
    """
    size, half = len(spectrum), len(spectrum) // 2
    surface = fft.irfft2(other * (spectrum if half_turn else np.conj(spectrum)), s=(size, size))
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    shift = (np.array([column, row], dtype=np.float64) + half_turn + half) % size - half
    return float(surface[row, column]), shift
