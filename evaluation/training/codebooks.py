"""Learn the codebooks of the place descriptor from submaps of other places than those that will be queried."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.bev import reversed_patches
from core.cluster_normals import ClusterStatistics
from core.config import FusionConfig
from core.descriptor import with_reversed
from core.vlad import Codebooks, aggregate, project_locally

Array = NDArray[np.float32]


def train_codebooks(
    patches: list[Array], micro: list[ClusterStatistics], cells: int, config: FusionConfig, seed: int
) -> Codebooks:
    """Codebooks from the patch descriptors (n, d) and cluster statistics of each training submap; deterministic."""
    rng = np.random.default_rng(seed)
    basis, parity = train_local_basis(sample_rows(patches, 60_000, rng), cells, config.local_size)
    partial = _without_reduction(basis, parity)
    macro_features = [with_reversed(project_locally(one, partial), partial) for one in patches]
    macro_centres = k_means(sample_rows(macro_features, 40_000, rng), config.macro_centres, rng)
    micro_centres = k_means(sample_rows([one.histograms for one in micro], 40_000, rng), config.micro_centres, rng)
    macro_vectors = np.stack([aggregate(one, macro_centres) for one in macro_features])
    micro_vectors = np.stack(
        [aggregate(one.histograms, micro_centres, one.weights, config.literal_saliency) for one in micro]
    )
    macro_mean, macro_basis = principal_components(macro_vectors, config.macro_size, config.whitening)
    micro_mean, micro_basis = principal_components(micro_vectors, config.micro_size, config.whitening)
    return Codebooks(basis, parity, macro_centres, macro_mean, macro_basis, micro_centres, micro_mean, micro_basis)


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


def principal_components(vectors: Array, size: int, whitening: float) -> tuple[Array, Array]:
    """Mean (d,) and basis (p, d), p <= size, of vectors (n, d); component i is divided by eigenvalue_i ** whitening."""
    mean = vectors.mean(axis=0)
    _, singular, axes = np.linalg.svd((vectors - mean).astype(np.float64), full_matrices=False)
    kept = min(size, int((singular > 1e-6 * singular[0]).sum()))
    eigenvalues = singular[:kept] ** 2 / len(vectors)
    return mean.astype(np.float32), (axes[:kept] / eigenvalues[:, None] ** whitening).astype(np.float32)


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


def _without_reduction(basis: Array, parity: Array) -> Codebooks:
    nothing = np.zeros((0, 0), dtype=np.float32)
    return Codebooks(basis, parity, nothing, nothing[0:0].ravel(), nothing, nothing, nothing.ravel(), nothing)
