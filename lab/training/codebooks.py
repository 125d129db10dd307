"""Learn the codebooks of the place descriptor from submaps of other places than those that will be queried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev import reversed_patches
from revisit.core.config import FusionConfig
from revisit.core.descriptor.fusion import with_reversed
from revisit.core.descriptor.vlad import Codebooks, aggregate, project_locally
from revisit.core.micro.cluster_normals import ClusterStatistics
from revisit.core.spectra import PlaceSpectra

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Features:
    """The contribution of one view of a training place: patches (n, d), cluster statistics, layout (s,), spectra."""

    patches: Array
    micro: ClusterStatistics
    layout: Array
    spectra: PlaceSpectra


def train_codebooks(places: list[list[Features]], cells: int, config: FusionConfig, seed: int) -> Codebooks:
    """Codebooks from several views of each training place; deterministic."""
    rng = np.random.default_rng(seed)
    views = [view for place in places for view in place]
    patches = [view.patches for view in views]
    basis, parity = train_local_basis(sample_rows(patches, 60_000, rng), cells, config.local_size)
    partial = _without_folds(basis, parity)
    macro_features = [with_reversed(project_locally(one, partial), partial) for one in patches]
    macro_centres = k_means(sample_rows(macro_features, 40_000, rng), config.macro_centres, rng)
    micro_centres = k_means(sample_rows([v.micro.histograms for v in views], 40_000, rng), config.micro_centres, rng)
    macro_mean = np.mean([aggregate(one, macro_centres) for one in macro_features], axis=0)
    micro_mean = np.mean([aggregate(v.micro.histograms, micro_centres, v.micro.weights) for v in views], axis=0)
    layout_mean, layout_basis = discriminant_directions(
        np.sqrt([[view.layout for view in place] for place in places]), config.layout_size
    )
    spectrum_mean, spectrum_basis = discriminant_directions(
        np.array([[view.spectra.normal for view in place] for place in places]), config.spectrum_size
    )
    plan_mean, plan_basis = discriminant_directions(
        np.array([[view.spectra.plan for view in place] for place in places]), config.plan_size
    )
    return Codebooks(
        basis, parity, macro_centres, *_shortened(macro_mean, config.macro_size, rng),
        micro_centres, *_shortened(micro_mean, config.micro_size, rng), layout_mean, layout_basis,
        spectrum_mean, spectrum_basis, plan_mean, plan_basis,
    )  # fmt: skip


def _shortened(mean: Array, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """The mean (d,) and the folds that shorten a VLAD to `size`; of full size, the VLAD stays as the paper has it."""
    if size < len(mean):
        return mean, random_folds(len(mean), size, rng)
    return np.zeros_like(mean), np.arange(1.0, len(mean) + 1.0, dtype=np.float32)[None]


def train_local_basis(patches: Array, cells: int, size: int) -> tuple[Array, Array]:
    """Principal directions (l, d) of patches (n, d), and the parity (l,) of each under a turn by 180 degrees.

    Even and odd parts are analysed apart, so that turning a patch only changes signs.
    """
    turned = reversed_patches(patches, cells)
    vectors, values, parities = [], [], []
    for parity in (1.0, -1.0):
        part = ((patches + parity * turned) / 2.0).astype(np.float64)
        if parity > 0:
            part -= part.mean(axis=0)
        value, vector = np.linalg.eigh(part.T @ part / len(part))
        vectors.append(vector.T)
        values.append(value)
        parities.append(np.full(len(value), parity))
    order = np.argsort(-np.concatenate(values), kind="stable")[:size]
    return (
        np.concatenate(vectors)[order].astype(np.float32),
        np.concatenate(parities)[order].astype(np.float32),
    )


def k_means(features: Array, count: int, rng: np.random.Generator, rounds: int = 25) -> Array:
    """Centres (count, d) of features (n, d): k-means++ start, Lloyd steps, empty centres restart at random rows."""
    centres = _spread_start(features, count, rng)
    for _ in range(rounds):
        nearest = (features @ centres.T - 0.5 * np.einsum("ij,ij->i", centres, centres)).argmax(axis=1)
        sizes = np.bincount(nearest, minlength=count)
        sums = np.zeros(centres.shape)
        np.add.at(sums, nearest, features)
        centres = (sums / np.maximum(sizes, 1)[:, None]).astype(np.float32)
        empty = np.flatnonzero(sizes == 0)
        centres[empty] = features[rng.integers(len(features), size=len(empty))]
    return centres


def random_folds(size: int, folded: int, rng: np.random.Generator, places: int = 4) -> Array:
    """Signed places (places, size) for `core.descriptor.vlad.fold`; every one of the `folded` places occurs."""
    order = np.stack([rng.permutation(np.arange(size) % folded) for _ in range(places)])
    return np.asarray((order + 1) * rng.choice((-1.0, 1.0), order.shape), dtype=np.float32)


def discriminant_directions(vectors: NDArray[np.float64], size: int, shrinkage: float = 0.3) -> tuple[Array, Array]:
    """Mean (d,) and basis (size, d) that tell places apart and views of a place not, of vectors (places, views, d).

    Linear discriminant analysis: entries are divided by their standard deviation, the scatter within places (shrunk
    towards a multiple of the identity) is whitened, the principal axes of the places' means are kept.
    """
    mean, spread = vectors.mean(axis=(0, 1)), vectors.std(axis=(0, 1)) + 1e-9
    scaled = (vectors - mean) / spread
    inner = scaled - scaled.mean(axis=1, keepdims=True)
    within = np.einsum("gvi,gvj->ij", inner, inner) / (len(vectors) * (vectors.shape[1] - 1))
    within += shrinkage * np.trace(within) / len(within) * np.eye(len(within))
    values, axes = np.linalg.eigh(within)
    whitening = axes / np.sqrt(values) @ axes.T
    centres = scaled.mean(axis=1) @ whitening
    _, main = np.linalg.eigh(centres.T @ centres)
    basis = (whitening @ main[:, ::-1][:, :size]).T / spread
    return mean.astype(np.float32), basis.astype(np.float32)


def sample_rows(arrays: list[Array], limit: int, rng: np.random.Generator) -> Array:
    """At most `limit` rows of all arrays together, drawn evenly at random."""
    rows = np.concatenate(arrays)
    return rows if len(rows) <= limit else rows[rng.choice(len(rows), limit, replace=False)]


def _spread_start(features: Array, count: int, rng: np.random.Generator) -> Array:
    chosen = [features[rng.integers(len(features))]]
    gaps = np.full(len(features), np.inf)
    for _ in range(count - 1):
        gaps = np.minimum(gaps, ((features - chosen[-1]) ** 2).sum(axis=1))
        chosen.append(features[rng.choice(len(features), p=gaps / gaps.sum())])
    return np.stack(chosen).astype(np.float32)


def _without_folds(basis: Array, parity: Array) -> Codebooks:
    nothing = np.zeros((0, 0), dtype=np.float32)
    flat = nothing.ravel()
    return Codebooks(basis, parity, nothing, flat, nothing, nothing, flat, nothing, *[flat, nothing] * 3)
