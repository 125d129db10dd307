"""Codebooks, and aggregation of local features into one vector (VLAD; paper III-D, III-E Eq. 13)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Codebooks:
    """Learned codebooks, as plain float32 arrays.

    local_basis (l, d): projects patch histograms (d,) to l numbers; local_parity (l,) +-1: the sign each of them takes
    when the patch is turned by 180 degrees. macro_centres (k, l), macro_mean (k * l,) and macro_folds (h, k * l): h
    signed places 1..p of each entry in the projected vector (`fold`). micro_centres (c, e), micro_mean (c * e,) and
    micro_folds (h, c * e) likewise. layout_mean (s,) and layout_basis (r, s) of square roots of layout spectra;
    spectrum_mean and spectrum_basis of normal spectra, plan_mean and plan_basis of plan spectra likewise.
    """

    local_basis: Array
    local_parity: Array
    macro_centres: Array
    macro_mean: Array
    macro_folds: Array
    micro_centres: Array
    micro_mean: Array
    micro_folds: Array
    layout_mean: Array
    layout_basis: Array
    spectrum_mean: Array
    spectrum_basis: Array
    plan_mean: Array
    plan_basis: Array

    def to_arrays(self) -> dict[str, Array]:
        """The fields by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.floating]]) -> Codebooks:
        """The inverse of `to_arrays`; other names in `arrays` are ignored. Raises DataLoss where shapes disagree."""
        names = [field.name for field in dataclasses.fields(cls)]
        missing = [name for name in names if name not in arrays]
        if missing:
            raise DataLoss(f"the codebooks lack {', '.join(missing)}")
        books = cls(**{name: np.ascontiguousarray(arrays[name], dtype=np.float32) for name in names})
        books._check()
        return books

    def _check(self) -> None:
        macro, micro = self.macro_centres, self.micro_centres
        agree = (
            all(np.isfinite(array).all() for array in self.to_arrays().values())
            and self.local_basis.ndim == macro.ndim == micro.ndim == self.macro_folds.ndim == self.micro_folds.ndim == 2
            and self.local_parity.shape == (macro.shape[1],) == (len(self.local_basis),)
            and self.macro_mean.shape == (macro.size,) == self.macro_folds.shape[1:]
            and self.micro_mean.shape == (micro.size,) == self.micro_folds.shape[1:]
            and self.layout_mean.shape == self.layout_basis.shape[1:]
            and self.spectrum_mean.shape == self.spectrum_basis.shape[1:]
            and self.plan_mean.shape == self.plan_basis.shape[1:]
            and all((np.abs(folds) >= 1).all() for folds in (self.macro_folds, self.micro_folds))
        )
        if not agree:
            raise DataLoss("the shapes of the codebooks do not fit together, or they hold NaN")


def project_locally(descriptors: Array, codebooks: Codebooks) -> Array:
    """Patch histograms (n, d) as (n, l) unit vectors of their principal components."""
    projected = descriptors @ codebooks.local_basis.T
    length = np.maximum(np.linalg.norm(projected, axis=1, keepdims=True), 1e-12)
    return np.asarray(projected / length, dtype=np.float32)


def aggregate(
    features: Array, centres: Array, weights: NDArray[np.float64] | None = None, weigh_features: bool = False
) -> Array:
    """VLAD (k * d,): sums of the residuals of features (n, d) to their nearest centre (k, d).

    `weights` (n,) scale the residuals after assignment; with `weigh_features` they scale the features before it, the
    literal VLAD{alpha_m psi(C_m)} of Eq. 13. Each centre's block is L2-normalised (intra-normalisation), then the
    signed square root and the L2 norm are taken. No features give zeros.
    """
    blocks = np.zeros(centres.shape, dtype=np.float64)
    if len(features):
        used = features * weights[:, None] if weigh_features and weights is not None else features
        scores = used @ centres.T - 0.5 * np.einsum("ij,ij->i", centres, centres)
        nearest = scores.argmax(axis=1)
        residuals = used - centres[nearest]
        if weights is not None and not weigh_features:
            residuals = residuals * weights[:, None]
        order = np.argsort(nearest, kind="stable")  # sums of neighbouring rows: faster than `np.add.at`, and the same
        named = nearest[order]
        starts = np.flatnonzero(np.diff(named, prepend=-1))
        blocks[named[starts]] = np.add.reduceat(residuals[order].astype(np.float64), starts, axis=0)
    blocks /= np.maximum(np.linalg.norm(blocks, axis=1, keepdims=True), 1e-12)
    flat = np.sign(blocks) * np.sqrt(np.abs(blocks))
    return unit(flat.ravel())


def fold(vector: Array, mean: Array, folds: Array) -> Array:
    """Sparse random projection of a VLAD vector (d,) to (p,), L2-normalised; a zero vector stays zero.

    Every entry is added, with a sign, to h of p places: `folds` (h, d) holds +-(place + 1). Cosines are kept but for
    noise of about 1 / sqrt(p) (Johnson-Lindenstrauss; docs/decisions/0017).
    """
    size = folded_size(folds)
    if not vector.any():
        return np.zeros(size, dtype=np.float32)
    signed = np.sign(folds) * (vector - mean)
    places = np.abs(folds).astype(np.int64) - 1
    folded: NDArray[np.float64] = np.bincount(places.ravel(), weights=signed.ravel(), minlength=size).astype(float)
    return unit(folded)


def folded_size(folds: Array) -> int:
    """The length p of a folded vector."""
    return int(np.abs(folds).max())


def unit(vector: NDArray[np.floating]) -> Array:
    """The vector divided by its L2 norm; zeros stay zeros."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12), dtype=np.float32)
