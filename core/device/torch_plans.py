"""Phase correlation of many plans at once, by torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from revisit.core.device.contract import Agreement, Correlation


def agreements(jobs: Sequence[Correlation], pixel: float, where: torch.device) -> list[list[Agreement]]:
    """For each job and each of its yaws the best shift, and that for half a turn more, as of `Kernels.correlate`."""
    turns = [(number, yaw) for number, job in enumerate(jobs) for yaw in job.yaws]
    if not turns:
        return [[] for _ in jobs]
    size = len(jobs[0].spectrum)
    images = torch.stack([_plan(jobs[number], yaw, pixel, where) for number, yaw in turns])
    others = torch.stack([torch.as_tensor(job.spectrum, device=where) for job in jobs])
    others = others[torch.tensor([number for number, _ in turns], device=where)]
    norms = images.flatten(1).norm(dim=1).clamp(min=1e-12)
    spectra = torch.fft.rfft2(images.float())
    products = torch.stack([others * spectra.conj(), others * spectra], dim=1)
    surfaces = torch.fft.irfft2(products, s=(size, size)).flatten(2)
    best = surfaces.argmax(dim=2)
    peaks = (surfaces.gather(2, best[..., None])[..., 0].double() / norms[:, None]).cpu().numpy()
    found: list[list[Agreement]] = [[] for _ in jobs]
    for (number, yaw), peak, cell in zip(turns, peaks, best.cpu().numpy(), strict=True):
        for half_turn in (0, 1):
            row, column = divmod(int(cell[half_turn]), size)
            shift = (np.array([column, row], dtype=np.float64) + half_turn + size // 2) % size - size // 2
            found[number].append(Agreement(float(peak[half_turn]), yaw + np.pi * half_turn, shift))
    return found


def _plan(job: Correlation, yaw: float, pixel: float, where: torch.device) -> Tensor:
    """As `kernels.plan_images.plan_density`."""
    size, points = len(job.spectrum), torch.as_tensor(job.points, device=where)
    cosine, sine = float(np.cos(yaw)), float(np.sin(yaw))
    x = torch.floor((points[:, 0] * cosine - points[:, 1] * sine) / pixel).long() + size // 2
    y = torch.floor((points[:, 0] * sine + points[:, 1] * cosine) / pixel).long() + size // 2
    inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
    cells = (y * size + x)[inside]
    here = torch.log1p(torch.bincount(cells, minlength=size * size).double()).reshape(size, size)
    around = here.roll(1, 0) + here.roll(-1, 0) + here.roll(1, 1) + here.roll(-1, 1)
    image = here + 0.5 * around
    return image - image.mean()
