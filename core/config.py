"""Every parameter of the method, once: default, unit and source.

A source names the paper's section or equation, another work, or "own" (then docs/decisions says why).
`docs/reference/parameters.md` is generated from this file.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any


def parameter(default: Any, unit: str, source: str, meaning: str) -> Any:
    """A dataclass field with its unit, source and meaning."""
    return dataclasses.field(default=default, metadata={"unit": unit, "source": source, "meaning": meaning})


@dataclass(frozen=True)
class SubmapConfig:
    """How scans become submaps (paper III-A)."""

    tau: float = parameter(10.0, "m", "paper III-A, tau_n", "travelled distance covered by one submap")
    stride: float = parameter(5.0, "m", "own", "travelled distance between the starts of two submaps")
    max_range: float = parameter(80.0, "m", "PIN-SLAM", "returns beyond this range are not used")
    min_range: float = parameter(1.0, "m", "own", "returns nearer than this hit the robot itself")


@dataclass(frozen=True)
class ImplicitMapConfig:
    """Elastic neural points, decoder, samples and fitting (paper III-B)."""

    resolution: float = parameter(0.4, "m", "PIN-SLAM", "edge of a neural-point voxel, also mesh voxel and BEV pixel")
    eviction_distance: float = parameter(
        0.7, "m", "paper III-B 3", "a stored neural point farther than this from a new return is replaced"
    )
    neighbours: int = parameter(6, "points", "paper Eq. 3, K", "neural points blended for one query")
    search_rings: int = parameter(2, "voxels", "own", "neighbours are sought among the voxels within this distance")
    weight_power: float = parameter(1.0, "1", "paper Eq. 3", "power of the inverse distance weight")
    feature_size: int = parameter(8, "1", "paper III-B, F", "latent features of a neural point")
    truncation: float = parameter(0.6, "m", "method notes", "signed distances are cut at this value")
    rays_per_point: int = parameter(1, "rays", "own", "returns a neural point contributes to the training set")
    near_samples: int = parameter(4, "samples/ray", "method notes", "samples around the return")
    near_sigma: float = parameter(0.25, "m", "method notes", "standard deviation of the near samples along the ray")
    front_samples: int = parameter(2, "samples/ray", "method notes", "samples in the free space before the return")
    front_reach: float = parameter(2.0, "m", "own", "free-space samples lie within this distance before the return")
    behind_samples: int = parameter(1, "samples/ray", "method notes", "samples behind the return")
    behind_reach: float = parameter(0.6, "m", "method notes", "samples behind lie within this distance")
    loss: str = parameter("bce", "bce or l1", "PIN-SLAM", "loss on the signed distance")
    loss_scale: float = parameter(0.08, "m", "PIN-SLAM", "scale of the sigmoid of the bce loss")
    feature_decay: float = parameter(0.01, "1", "own", "weight of the squared latent features in the loss")
    steps: int = parameter(10, "steps", "paper III-B 5", "gradient steps a submap")
    batch: int = parameter(16384, "samples", "PIN-SLAM", "samples a gradient step")
    learning_rate: float = parameter(0.01, "1", "PIN-SLAM", "Adam step size")
    update_decoder: bool = parameter(False, "", "paper III-B 5", "also adapt the decoder while fitting")
    dynamic_distance: float = parameter(0.3, "m", "paper Eq. 6, gamma_d", "a dynamic point lies farther from the surface")
    dynamic_stability: int = parameter(
        2, "scans", "paper Eq. 6, gamma_mu", "scans that must have seen free space where a dynamic point was"
    )


@dataclass(frozen=True)
class SurfaceConfig:
    """Mesh, normals and occupancy out of the field (paper III-C)."""

    observed_distance: float = parameter(
        0.6, "m", "method notes", "corners farther than this from every neural point are unobserved"
    )
    min_component: int = parameter(12, "vertices", "own", "connected mesh parts with fewer vertices are noise")
    min_returns: int = parameter(2, "returns", "own", "no-implicit ablation: returns an occupied voxel needs")


@dataclass(frozen=True)
class ClusterConfig:
    """Ground removal and fast Euclidean clustering (paper III-C)."""

    ground_cosine: float = parameter(0.85, "1", "method notes", "|n_z| of ground vertices")
    ground_height: float = parameter(0.5, "m", "method notes", "ground lies this near the lower envelope")
    ground_cell: float = parameter(2.0, "m", "own", "edge of a column of the lower envelope")
    radius: float = parameter(0.8, "m", "method notes", "vertices nearer than this belong together")
    min_vertices: int = parameter(60, "vertices", "method notes", "smaller clusters are not dominant")


@dataclass(frozen=True)
class BevConfig:
    """Cluster-guided BEV image and its features (paper III-D, III-E)."""

    half_range: float = parameter(50.0, "m", "method notes", "the image covers +- this distance from the submap centre")


@dataclass(frozen=True)
class MicroConfig:
    """Cluster normal statistics and saliency (paper III-C, III-E)."""


@dataclass(frozen=True)
class FusionConfig:
    """VLAD aggregation and fusion (paper III-D, III-E)."""


@dataclass(frozen=True)
class LoopConfig:
    """Which earlier submaps are candidates."""

    min_index_gap: int = parameter(50, "submaps", "paper IV-B", "submaps of one session nearer than this are no loop")
    candidates: int = parameter(20, "submaps", "method notes", "nearest descriptors that are verified")


@dataclass(frozen=True)
class VerificationConfig:
    """Geometric verification of a candidate (paper III-E, end)."""


@dataclass(frozen=True)
class PipelineConfig:
    """All parameters of the method."""

    submap: SubmapConfig = dataclasses.field(default_factory=SubmapConfig)
    implicit_map: ImplicitMapConfig = dataclasses.field(default_factory=ImplicitMapConfig)
    surface: SurfaceConfig = dataclasses.field(default_factory=SurfaceConfig)
    clusters: ClusterConfig = dataclasses.field(default_factory=ClusterConfig)
    bev: BevConfig = dataclasses.field(default_factory=BevConfig)
    micro: MicroConfig = dataclasses.field(default_factory=MicroConfig)
    fusion: FusionConfig = dataclasses.field(default_factory=FusionConfig)
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    verification: VerificationConfig = dataclasses.field(default_factory=VerificationConfig)
