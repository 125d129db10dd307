"""Counts of a place and filters of its plan, by torch (paper III-D, decision 0017)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lab.gpu.arrays import moved_there
from lab.gpu.kernels import Array, Array64, Patches
from lab.gpu.order import Groups


class TorchViews:
    """`ViewKernels` on a device of torch."""

    def __init__(self, where: torch.device) -> None:
        """Everything is computed on `where`."""
        self._where = where
        self._bank: tuple[Array, Tensor] | None = None

    def strongest_orientations(self, image: Array, bank: Array) -> tuple[NDArray[np.int8], Array]:
        """See `ViewKernels`. All filters of an orientation at once; rows that the image has not are not filtered."""
        (height, width), size = image.shape, bank.shape[-1]
        spectrum = torch.fft.fft2(self._there(image), s=(size, size))
        amplitude = torch.stack([_amplitude(filters * spectrum, height, width) for filters in self._kept(bank)])
        strongest = amplitude.amax(0)
        numbers = torch.arange(len(bank), dtype=torch.int8, device=self._where)[:, None, None]
        index = torch.where(amplitude == strongest, numbers, len(bank)).amin(0)  # the first of equal ones
        return index.to(torch.int8).cpu().numpy(), strongest.cpu().numpy()

    def discs(self, layers: Array, pixels: NDArray[np.int64], disc: Array) -> Array:
        """See `ViewKernels`."""
        radius = len(disc) // 2
        padded = torch.nn.functional.pad(self._there(layers), (radius, radius, radius, radius))
        column, row = self._there(pixels).unbind(1)
        offsets = torch.arange(len(disc), device=self._where)
        windows = padded[:, (row[:, None] + offsets)[:, :, None], (column[:, None] + offsets)[:, None]]
        sums: Array = torch.einsum("lnij,ij->nl", windows, self._there(disc)).cpu().numpy()
        return sums

    def patches(
        self, index: NDArray[np.int8], weights: Array, pixels: NDArray[np.int64], angles: Array, form: Patches
    ) -> Array:
        """See `ViewKernels`."""
        bins, cells = form.bins, form.cells
        orientations, counted = self._there(index).long(), self._there(weights)
        column, row, part = self._sampled(self._there(pixels), angles, form)
        inside = (row >= 0) & (column >= 0) & (row < len(index)) & (column < index.shape[1])
        row, column = torch.where(inside, row, 0), torch.where(inside, column, 0)
        weight = torch.where(inside, counted[row, column], 0.0)
        turn = self._there(angles.astype(np.float64) * bins / np.pi)[:, None, None]
        relative = orientations[row, column] - turn
        relative = torch.where(relative < 0.0, (relative + bins).clamp(min=0.0), relative)
        lower = relative.long()
        share, upper = relative - lower, torch.where(lower + 1 < bins, lower + 1, 0)
        start = (torch.arange(len(pixels), device=self._where)[:, None, None] * cells * cells + part) * bins
        rows = torch.stack([start + lower % bins, start + upper]).reshape(-1)
        values = torch.stack([weight * (1.0 - share), weight * share]).reshape(-1)
        groups = Groups.of(rows, len(pixels) * cells * cells * bins)
        sums = groups.sums(values, max(float(weights.max(initial=0.0)), 1e-30))
        histograms: Array = sums.float().reshape(len(pixels), -1).cpu().numpy()
        return histograms

    def faces(
        self, vertices: Array64, heading: Array64, weight: Array64, shape: tuple[int, int], spacing: float,
        sharpness: float,
    ) -> Array64:  # fmt: skip
        """See `ViewKernels`."""
        (headings, bins), step = shape, 2.0 * np.pi / shape[0]
        counted = weight > 0.0
        vertices, heading, weight = vertices[counted], heading[counted], weight[counted]
        rows = np.arange(-headings, headings + 1)
        cosines, sines = self._there(np.cos(rows * step)), self._there(np.sin(rows * step))
        spread = torch.arange(-(headings // 6), headings // 6 + 1, device=self._where)
        row = self._there(np.round(heading / step).astype(np.int64))[:, None] + spread
        cosine, sine = cosines[row + headings], sines[row + headings]
        x, y = self._there(vertices)[:, :, None].unbind(1)
        facing = self._there(np.cos(heading))[:, None] * cosine + self._there(np.sin(heading))[:, None] * sine
        column = torch.floor((x * cosine + y * sine) / spacing).long() + bins // 2
        there = (facing > 0.0) & (column >= 0) & (column < bins)
        values = (self._there(weight)[:, None] * facing.clamp(min=0.0) ** sharpness)[there]
        return self._profiles(values, (torch.remainder(row, headings) * bins + column)[there], shape)

    def plans(self, places: Array64, weight: Array64, shape: tuple[int, int], spacing: float) -> Array64:
        """See `ViewKernels`."""
        headings, bins = shape
        angles = np.arange(headings) * np.pi / headings
        x, y = self._there(places)[:, None].unbind(2)
        cosine, sine = self._there(np.cos(angles)), self._there(np.sin(angles))
        column = torch.floor((x * cosine + y * sine) / spacing).long() + bins // 2
        there = (column >= 0) & (column < bins)
        rows = torch.arange(headings, device=self._where) * bins + column
        values = self._there(weight)[:, None].expand(-1, headings)
        return self._profiles(values[there], rows[there], shape)

    def _profiles(self, values: Tensor, rows: Tensor, shape: tuple[int, int]) -> Array64:
        """Sums of `values` (n,) at places `rows` (n,) of profiles; a weight is at most 1."""
        sums: Array64 = Groups.of(rows, shape[0] * shape[1]).sums(values, 1.0).reshape(shape).cpu().numpy()
        return sums

    def _sampled(self, pixels: Tensor, angles: Array, form: Patches) -> tuple[Tensor, Tensor, Tensor]:
        """Columns and rows (n, i, j) where the patch around each of `pixels` (n, 2) is sampled, and parts (i, j)."""
        begins = torch.arange((form.edge + form.step - 1) // form.step, device=self._where) * form.step
        offsets, parts = begins.double() + 0.5 * form.step - 0.5 * form.edge, begins * form.cells // form.edge
        cosine, sine = (self._there(turn)[:, None, None].double() for turn in (np.cos(angles), np.sin(angles)))
        x, y = pixels[:, :, None, None].unbind(1)
        column = torch.round(x + cosine * offsets - sine * offsets[:, None]).long()
        row = torch.round(y + sine * offsets + cosine * offsets[:, None]).long()
        return column, row, parts[:, None] * form.cells + parts

    def _kept(self, bank: Array) -> Tensor:
        """The filters on the device, moved there once: a pipeline has one bank."""
        if self._bank is None or self._bank[0] is not bank:
            self._bank = bank, self._there(bank)
        return self._bank[1]

    def _there(self, array: NDArray[np.generic]) -> Tensor:
        return moved_there(array, self._where)


def _amplitude(products: Tensor, height: int, width: int) -> Tensor:
    """The sum (h, w) over the scales of the moduli of what the `products` (s, k, k) are the spectra of."""
    rows = torch.fft.ifft(products, dim=1)[:, :height]
    amplitude: Tensor = torch.fft.ifft(rows, dim=2)[:, :, :width].abs().sum(0)
    return amplitude
