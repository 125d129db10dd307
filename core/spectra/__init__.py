"""Global cues of a place that neither its heading nor its origin changes: of its faces and of its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import SpectrumConfig
from revisit.core.spectra.normal import normal_spectrum
from revisit.core.spectra.plan import plan_spectrum
from revisit.core.stages import stage
from revisit.core.surface import Surface

Array = NDArray[np.float32]

__all__ = ["PlaceSpectra", "describe_spectra"]


@dataclass(frozen=True)
class PlaceSpectra:
    """The normal spectrum and the plan spectrum, (s,) float32 each; zeros where the place shows nothing of the kind."""

    normal: Array
    plan: Array


@stage("spectra")
def describe_spectra(surface: Surface, clusters: Clusters, config: SpectrumConfig) -> PlaceSpectra:
    """Both spectra of the dominant clusters."""
    return PlaceSpectra(normal_spectrum(surface, clusters, config), plan_spectrum(surface, clusters, config))
