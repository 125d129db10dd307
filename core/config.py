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
    dynamic_distance: float = parameter(
        0.3, "m", "paper Eq. 6, gamma_d", "a dynamic point lies farther from the surface"
    )
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
    standing_height: float = parameter(0.7, "m", "own, decision 0008", "a low column of less extent is ground")
    ground_slope: float = parameter(0.03, "1", "own, decision 0008", "rise of the ground over its plane with distance")
    radius: float = parameter(0.8, "m", "method notes", "vertices nearer than this belong together")
    min_vertices: int = parameter(60, "vertices", "method notes", "smaller clusters are not dominant")


@dataclass(frozen=True)
class BevConfig:
    """Cluster-guided BEV image and its features (paper III-D, III-E)."""

    half_range: float = parameter(50.0, "m", "method notes", "the image covers +- this distance from the submap centre")
    cluster_distance: float = parameter(
        0.6, "m", "paper Eq. 7, delta_c", "voxels this near a dominant cluster are projected"
    )
    min_support: float = parameter(
        0.5, "1", "own", "share of the standing voxels below which all of them are projected"
    )
    normalisation: str = parameter("log", "log, linear or binary", "paper Eq. 9, eta", "evidence to image intensity")
    saturation_quantile: float = parameter(0.95, "1", "own", "occupied pixels above this quantile are white")
    scales: int = parameter(4, "1", "BVMatch", "scales of the log-Gabor filters")
    orientations: int = parameter(6, "1", "method notes", "orientations of the log-Gabor filters and of the histograms")
    wavelength: float = parameter(3.0, "px", "BVMatch", "wavelength of the finest filter")
    scale_factor: float = parameter(1.6, "1", "BVMatch", "ratio of the wavelengths of two scales")
    bandwidth: float = parameter(0.75, "1", "BVMatch", "sigma over centre frequency of the radial part")
    filter_margin: int = parameter(32, "px", "own", "empty border against wrap-around of the filters")
    keypoint_source: str = parameter(
        "image", "image or mim", "BVMatch; paper III-D: mim", "where FAST looks for corners"
    )
    fast_threshold: int = parameter(10, "grey levels", "method notes", "contrast of a FAST corner")
    max_keypoints: int = parameter(200, "keypoints", "method notes", "the strongest corners are kept")
    min_keypoints: int = parameter(40, "keypoints", "own", "filled up with amplitude maxima where corners are fewer")
    context_px: int = parameter(138, "px", "method notes", "diameter of the disc that sets a keypoint's orientation")
    patch_px: int = parameter(96, "px", "method notes", "edge of the described patch")
    patch_step: int = parameter(2, "px", "own", "sampling distance inside the patch")
    cells: int = parameter(6, "1", "BVMatch", "parts of the patch along each edge")
    amplitude_power: float = parameter(0.5, "1", "own", "weight of a pixel is this power of its filter amplitude")
    layout_power: float = parameter(2.0, "1", "own, decision 0006", "intensities are raised to this power")
    layout_blur: float = parameter(1.0, "px", "own, decision 0006", "standard deviation of the blur")
    layout_radii: int = parameter(24, "1", "own, decision 0006", "frequencies of the layout spectrum")
    layout_angles: int = parameter(60, "1", "own, decision 0006", "angles of the layout spectrum over half a turn")
    layout_frequency: float = parameter(0.2, "cycles/px", "own, decision 0006", "highest frequency")
    layout_harmonics: int = parameter(6, "1", "own, decision 0006", "harmonics over the angle, beside their mean")


@dataclass(frozen=True)
class MicroConfig:
    """Cluster normal statistics and saliency (paper III-C, III-E)."""

    evaluation: str = parameter(
        "keypoint", "keypoint or cluster", "paper Fig. 2b; III-C: cluster", "where psi is evaluated"
    )
    radius: float = parameter(8.0, "m", "own", "column around a keypoint over which psi is evaluated")
    distance_bins: int = parameter(3, "1", "own; paper III-C: 1", "classes of pairs of regions by horizontal distance")
    height_bins: int = parameter(1, "1", "own; paper III-C: 1", "classes of pairs of regions by height difference")
    pairs_per_keypoint: int = parameter(60, "pairs", "paper III-C, n_m", "random pairs for each keypoint of a cluster")
    epsilon: float = parameter(
        0.5, "keypoints", "paper Eq. 12", "keeps the weight of clusters without keypoints positive"
    )


@dataclass(frozen=True)
class SpectrumConfig:
    """Spectra of profiles along all headings: of faces (normal spectrum) and of the plan (plan spectrum)."""

    headings: int = parameter(72, "1", "own, decision 0015", "headings, over a turn for faces, over half for the plan")
    reach: float = parameter(65.0, "m", "own, decision 0017", "weights fall to zero at this distance")
    spacing: float = parameter(1.0, "m", "own, decision 0015", "bin of a profile")
    sharpness: float = parameter(
        4.0, "1", "own, decision 0015", "power of the cosine by which a face counts for a heading near its own"
    )
    frequencies: int = parameter(24, "1", "own, decision 0015", "frequencies of a spectrum")
    highest: float = parameter(0.25, "cycles/m", "own, decision 0015", "highest frequency")
    harmonics: int = parameter(12, "1", "own, decision 0015", "harmonics over the heading, beside their mean")
    neighbours: int = parameter(
        1, "1", "own, decision 0017", "higher frequencies with which each one's harmonics are compared in phase"
    )


@dataclass(frozen=True)
class FusionConfig:
    """VLAD aggregation and fusion (paper III-D, III-E)."""

    local_size: int = parameter(64, "1", "own", "principal components kept of a patch histogram")
    macro_centres: int = parameter(128, "1", "own", "codebook size of the BEV patches")
    micro_centres: int = parameter(16, "1", "method notes", "codebook size of the cluster histograms")
    macro_size: int = parameter(196, "1", "own, decision 0007", "length of the BEV part")
    micro_size: int = parameter(30, "1", "own, decision 0007", "length of the VLAD of the cluster part")
    spectrum_size: int = parameter(330, "1", "own, decision 0017", "length of the normal spectrum in the cluster part")
    layout_size: int = parameter(168, "1", "own, decision 0006", "length of the layout part")
    plan_size: int = parameter(300, "1", "own, decision 0017", "length of the plan part")
    macro_weight: float = parameter(0.4, "1", "paper Eq. 14, lambda_B", "weight of the BEV part")
    micro_weight: float = parameter(0.7, "1", "paper Eq. 14, lambda_G", "weight of the cluster part")
    histogram_share: float = parameter(0.3, "1", "own, decision 0015", "weight of the VLAD beside the normal spectrum")
    layout_weight: float = parameter(0.7, "1", "own, decision 0006", "weight of the layout part")
    plan_weight: float = parameter(0.7, "1", "own, decision 0017", "weight of the plan part")
    literal_saliency: bool = parameter(False, "", "paper Eq. 13", "weigh cluster histograms before assignment")


@dataclass(frozen=True)
class LoopConfig:
    """Which earlier submaps are candidates."""

    min_index_gap: int = parameter(50, "submaps", "paper IV-B", "submaps of one session nearer than this are no loop")
    candidates: int = parameter(20, "submaps", "method notes", "nearest descriptors that are verified")


@dataclass(frozen=True)
class VerificationConfig:
    """Geometric verification of a candidate (paper III-E, end)."""

    spacing: float = parameter(
        0.8, "m", "own", "edge of the cubes of which a stored place keeps one surface point each"
    )
    standing_points: int = parameter(2500, "points", "own", "most surface points off the ground in a stored place")
    ground_points: int = parameter(800, "points", "own", "most ground points in a stored place")
    min_standing: int = parameter(100, "points", "own", "a place with fewer points off the ground is degenerate")
    min_spread: float = parameter(0.5, "m", "own", "smallest horizontal standard deviation of a place that is no line")
    correspondences: int = parameter(160, "pairs", "own", "most similar pairs of keypoints that vote for a pose")
    keypoint_tolerance: float = parameter(1.2, "m", "own", "correspondences nearer than this agree with a pose")
    yaw_tolerance: float = parameter(25.0, "deg", "own", "largest error of the yaw that a correspondence implies")
    sure_inliers: int = parameter(25, "keypoints", "own", "below, poses by phase correlation are tried too")
    starts: int = parameter(3, "poses", "own", "most planar poses that are refined by ICP")
    correlation_pixel: float = parameter(0.8, "m", "own", "pixel of the images for phase correlation")
    correlation_turns: int = parameter(3, "yaws", "own", "yaws tried by phase correlation, each in both directions")
    coarse_rounds: int = parameter(10, "steps", "own", "coarse ICP steps")
    coarse_share: int = parameter(5, "points", "own", "coarse steps use every so many-th point")
    coarse_distance: float = parameter(3.0, "m", "own", "reach of the coarse ICP steps")
    min_agreement: float = parameter(0.2, "1", "own", "share of points on the other surface below which ICP ends early")
    fine_rounds: int = parameter(6, "steps", "own", "ICP steps on all points")
    fine_distance: float = parameter(1.0, "m", "own", "reach of the fine ICP steps")
    neighbour_distance: float = parameter(1.0, "m", "own", "a surface point has its counterpart within this distance")
    surface_distance: float = parameter(0.25, "m", "own", "and lies this near to its tangent plane")
    contrast_shifts: tuple[float, ...] = parameter(
        (2.5, 4.0, 6.0), "m", "own, decision 0016", "moves along the weakest direction that a loop must not survive"
    )
    min_contrast: float = parameter(
        0.08, "1", "own, decision 0016", "smallest overlap that such a move must cost, else the pose is not fixed"
    )
    sight_angle: float = parameter(3.0, "deg", "own, decision 0018", "directions in which places have looked")
    sight_margin: float = parameter(2.0, "m", "own, decision 0018", "farther behind, it is looked through")
    sight_near: float = parameter(4.0, "m", "own, decision 0018", "nearer points look too different from scan to scan")
    sight_far: float = parameter(40.0, "m", "own, decision 0018", "farther points are too sparse to tell")
    max_seen_through: float = parameter(
        0.35, "1", "own, decision 0018", "largest share of what stands that the other place has looked through"
    )
    min_common: int = parameter(60, "points", "own", "standing points of each place in the region both have seen")
    min_common_share: float = parameter(0.35, "1", "own", "of the smaller place must stand in that region")
    max_tilt: float = parameter(15.0, "deg", "own", "largest tilt between two gravity-aligned submaps")
    min_overlap: float = parameter(0.3, "1", "own", "smallest share of common surface")
    min_observability: float = parameter(0.002, "1", "own", "smallest eigenvalue share of the ICP information")
    lever: float = parameter(15.0, "m", "own", "lever arm at which rotations are compared with translations")
    min_sigma: float = parameter(0.03, "m", "own", "residuals are trusted no better than this")
    correlated_points: float = parameter(20.0, "points", "own", "points that share one error")
    min_score: float = parameter(0.5, "1", "own", "smallest score of a verified loop")


@dataclass(frozen=True)
class PipelineConfig:
    """All parameters of the method.

    The method was built for streets. `scene_scale` is how large a scene is compared with one: lengths are divided by it
    after the submap is built, so that 0.25 makes rooms of 5 m look like streets of 20 m.
    """

    scene_scale: float = parameter(1.0, "1", "own, decision 0009", "size of the scene compared with a street")
    submap: SubmapConfig = dataclasses.field(default_factory=SubmapConfig)
    implicit_map: ImplicitMapConfig = dataclasses.field(default_factory=ImplicitMapConfig)
    surface: SurfaceConfig = dataclasses.field(default_factory=SurfaceConfig)
    clusters: ClusterConfig = dataclasses.field(default_factory=ClusterConfig)
    bev: BevConfig = dataclasses.field(default_factory=BevConfig)
    micro: MicroConfig = dataclasses.field(default_factory=MicroConfig)
    spectra: SpectrumConfig = dataclasses.field(default_factory=SpectrumConfig)
    fusion: FusionConfig = dataclasses.field(default_factory=FusionConfig)
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    verification: VerificationConfig = dataclasses.field(default_factory=VerificationConfig)
