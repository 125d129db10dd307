"""The fused place descriptor (paper III-E, Eq. 13-15)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev import BevFeatures
from revisit.core.config import FusionConfig
from revisit.core.descriptor.vlad import Codebooks, aggregate, fold, project_locally, unit
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.micro.cluster_normals import ClusterStatistics
from revisit.core.spectra import PlaceSpectra
from revisit.core.stages import stage

Array = NDArray[np.float32]


@dataclass(frozen=True)
class PlaceDescriptor:
    """One place as a unit vector (d,) float32; only descriptors of the same model are comparable."""

    vector: Array
    model_version: str

    def similarity(self, other: PlaceDescriptor) -> float:
        """The cosine of Eq. 15, in [-1, 1]. Raises DescriptorModelMismatch across models."""
        if self.model_version != other.model_version:
            raise DescriptorModelMismatch
        return float(self.vector @ other.vector)  # Eq. 15


@dataclass(frozen=True)
class PlaceFeatures:
    """The parts of the fused descriptor."""

    bev: BevFeatures
    micro: ClusterStatistics
    spectra: PlaceSpectra


@stage("fusion")
def fuse(features: PlaceFeatures, codebooks: Codebooks, config: FusionConfig, model_version: str) -> PlaceDescriptor:
    """Norm([lambda_B F^B, lambda_G F^G, lambda_L F^L, lambda_P F^P]) (Eq. 14, layout and plan added).

    A part that saw nothing is zero.
    """
    parts = (
        config.macro_weight * macro_descriptor(features.bev, codebooks),
        config.micro_weight * micro_descriptor(features, codebooks, config),
        config.layout_weight * layout_descriptor(features.bev, codebooks),
        config.plan_weight * discriminated(features.spectra.plan, codebooks.plan_mean, codebooks.plan_basis),
    )
    return PlaceDescriptor(unit(np.concatenate(parts)), model_version)  # Eq. 14


def without_parts(vector: Array, config: FusionConfig, *, bev: bool = False, normals: bool = False) -> Array:
    """The result of `fuse` without the BEV parts, or the cluster part, from its `vector` (d,)."""
    macro_end, micro_end = config.macro_size, config.macro_size + config.micro_size + config.spectrum_size
    kept = vector.copy()
    if bev:
        kept[:macro_end] = kept[micro_end:] = 0.0
    if normals:
        kept[macro_end:micro_end] = 0.0
    return unit(kept)


def macro_descriptor(bev: BevFeatures, codebooks: Codebooks) -> Array:
    """F^B (p,): VLAD of the patches, each in both of its directions, so that a turn by 180 degrees changes nothing."""
    vlad = aggregate(with_reversed(project_locally(bev.descriptors, codebooks), codebooks), codebooks.macro_centres)
    return fold(vlad, codebooks.macro_mean, codebooks.macro_folds)


def micro_descriptor(features: PlaceFeatures, codebooks: Codebooks, config: FusionConfig) -> Array:
    """F^G (q,): saliency-weighted VLAD of the cluster histograms (Eq. 13), and their normal spectrum beside it."""
    micro = features.micro
    vlad = aggregate(micro.histograms, codebooks.micro_centres, micro.weights, config.literal_saliency)  # Eq. 13
    histograms = fold(vlad, codebooks.micro_mean, codebooks.micro_folds)
    faces = discriminated(features.spectra.normal, codebooks.spectrum_mean, codebooks.spectrum_basis)
    return unit(np.concatenate([config.histogram_share * histograms, config.spectrum_weight * faces]))


def layout_descriptor(bev: BevFeatures, codebooks: Codebooks) -> Array:
    """F^L (r,): the layout spectrum in directions that differ between places and not between visits (decision 0017)."""
    return discriminated(np.sqrt(bev.layout), codebooks.layout_mean, codebooks.layout_basis)


def discriminated(spectrum: Array, mean: Array, basis: Array) -> Array:
    """A spectrum (s,) in the directions (r, s) of a basis, as a unit vector; zeros stay zeros."""
    if not spectrum.any():
        return np.zeros(len(basis), dtype=np.float32)
    return unit(basis @ (spectrum - mean))


def with_reversed(projected: Array, codebooks: Codebooks) -> Array:
    """Projected patches (n, l) followed by those of the patches turned by 180 degrees."""
    return np.concatenate([projected, projected * codebooks.local_parity])
