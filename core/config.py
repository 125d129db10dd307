"""Every parameter of the method, once: default, unit and source.

A source names the paper's section or equation, another work, or "own" (then docs/decisions says why).
`docs/reference/parameters.md` is generated from this file.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn

import numpy as np

from revisit.core.errors import BadField
from revisit.core.string_enum import StrEnum

ANGLE_BINS = 18
"""Bins of the angles between regional normals, of ten degrees each (paper III-C)."""
PROFILE_BINS = 256
"""Bins of the transform of a profile along a heading."""
MAX_IMAGE_PX = 4096
"""Most pixels along an edge of the BEV image."""
MAX_VOXEL = 2**30
"""Voxel indices stay below, so that they and their neighbours fit into 32 bits."""


def parameter(
    default: Any, unit: str, source: str, meaning: str, *, low: float | None = None, high: float = math.inf
) -> Any:
    """A dataclass field with its unit, source and meaning.

    Numbers must be finite and lie in [low, high]; without `low` they must be greater than 0.
    """
    about = {"unit": unit, "source": source, "meaning": meaning, "low": low, "high": high}
    return dataclasses.field(default=default, metadata=about)


class Section:
    """Parameters that belong together, each checked once: when the section is made."""

    section: ClassVar[str]

    def __post_init__(self) -> None:
        for one in dataclasses.fields(self):  # type: ignore[arg-type]
            value = _checked(f"{self.section}.{one.name}", getattr(self, one.name), one.default, one.metadata)
            object.__setattr__(self, one.name, value)

    def refuse(self, name: str, reason: str) -> NoReturn:
        """Raise BadField for the parameter `name` of this section."""
        raise BadField(f"{self.section}.{name} {reason}", field=f"{self.section}.{name}")


def _checked(name: str, value: Any, default: Any, about: Mapping[str, Any]) -> Any:
    """The value of a parameter of the kind of its default. Raises BadField."""
    if isinstance(default, StrEnum):
        return _choice(name, value, type(default))
    if isinstance(default, tuple):
        if not isinstance(value, tuple | list) or not value:
            raise BadField(f"{name} must be a list of numbers, got {value!r}", field=name)
        return tuple(_checked(name, item, default[0], about) for item in value)
    kind: type = type(default)
    fits = isinstance(value, int | float | np.integer | np.floating) if kind is float else isinstance(value, kind)
    if not fits or isinstance(value, bool) is not (kind is bool):
        raise BadField(f"{name} must be of type {kind.__name__}, got {value!r}", field=name)
    if kind is not bool:
        _check_range(name, value, about["low"], about["high"])
    return value


def _choice(name: str, value: Any, choices: type[StrEnum]) -> StrEnum:
    try:
        return choices(value)
    except ValueError as error:
        raise BadField(f"{name} must be one of {', '.join(choices)}, got {value!r}", field=name) from error


def _check_range(name: str, value: float, low: float | None, high: float) -> None:
    above = value > 0 if low is None else value >= low
    if not (math.isfinite(value) and above and value <= high):
        least = "greater than 0" if low is None else f"at least {low:g}"
        most = "" if high == math.inf else f" and at most {high:g}"
        raise BadField(f"{name} must be {least}{most}, got {value!r}", field=name)


class Profile(StrEnum):
    """Which form of the method describes submaps: the product's, or the paper's as it is written (decision 0122)."""

    PRODUCT = "product"
    PAPER = "paper"


class Loss(StrEnum):
    """The regression of the paper (III-B 5), or the cross entropy of occupancy sigmoids (PIN-SLAM)."""

    L1 = "l1"
    BCE = "bce"


class Field(StrEnum):
    """Tangent planes of the neural points, blended; or with the correction of the decoder, learned (paper Eq. 5)."""

    PLANES = "planes"
    LEARNED = "learned"


class Fitting(StrEnum):
    """When a learned field takes its gradient steps (paper III-B 5): at the end, or as each scan comes."""

    AT_ONCE = "at once"
    SCAN_BY_SCAN = "scan by scan"


class Normalisation(StrEnum):
    """eta of Eq. 9: how the summed evidence of a column becomes intensity."""

    LOG = "log"
    LINEAR = "linear"
    BINARY = "binary"


class KeypointSource(StrEnum):
    """Where corners are sought: on the BEV image, or on the maximum index map as the paper says (III-D)."""

    IMAGE = "image"
    MIM = "mim"


class Evaluation(StrEnum):
    """Where psi is evaluated: at each keypoint (paper Fig. 2b), or over each whole cluster (paper III-C)."""

    KEYPOINT = "keypoint"
    CLUSTER = "cluster"


@dataclass(frozen=True)
class SubmapConfig(Section):
    """How scans become submaps (paper III-A)."""

    section: ClassVar[str] = "submap"

    tau: float = parameter(10.0, "m", "paper III-A, tau_n", "travelled distance covered by one submap")
    stride: float = parameter(5.0, "m", "own", "travelled distance between the starts of two submaps")
    max_range: float = parameter(80.0, "m", "PIN-SLAM", "returns beyond this range are not used")
    min_range: float = parameter(1.0, "m", "own", "returns nearer than this hit the robot itself", low=0)
    least_scans_per_tau: int = parameter(
        5,
        "scans",
        "own, decision 0341",
        "scans of tau that are described; doubled until they have enough returns",
        high=100,
    )
    enough_returns: int = parameter(
        300_000, "returns", "own, decision 0341", "so many returns the described scans of tau have together", low=0
    )
    turn_between_scans: float = parameter(
        30.0, "degrees", "own, decision 0341", "a scan turned by more is described between two marks, too", high=180
    )
    scans_per_tau: int = parameter(
        10, "scans", "own, decision 0339", "of a moving robot's view those tau over this apart are kept", high=1000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_range >= self.max_range:
            self.refuse("min_range", f"must be less than max_range, {self.max_range:g}")

    def surface_reach_m(self, scene_scale: float) -> float:
        """How far from a submap its surface may lie, metres; farther parts are in no tile."""
        return self.max_range * min(1.0, scene_scale) + 0.5 * self.tau


@dataclass(frozen=True)
class ImplicitMapConfig(Section):
    """Elastic neural points, decoder, samples and fitting (paper III-B)."""

    section: ClassVar[str] = "implicit_map"

    resolution: float = parameter(0.4, "m", "PIN-SLAM", "edge of a neural-point voxel, also mesh voxel and BEV pixel")
    neighbours: int = parameter(6, "points", "paper Eq. 3, K", "neural points blended for one query", high=64)
    search_rings: int = parameter(
        2, "voxels", "own", "neighbours are sought among the voxels within this distance", high=8
    )
    max_points: int = parameter(
        80_000, "points", "own, decision 0151", "most neural points of a submap; the farthest are left out"
    )
    weight_power: float = parameter(
        2.0, "1", "own, decision 0115; paper Eq. 3: 1", "power of the inverse distance weight", low=0
    )
    field: Field = parameter(
        Field.PLANES, "planes or learned", "own, decision 0115; paper Eq. 5: learned", "what the signed distance is"
    )
    feature_size: int = parameter(8, "1", "paper III-B, F", "latent features of a neural point", high=256)
    truncation: float = parameter(0.6, "m", "method notes", "signed distances are cut at this value")
    rays_per_point: int = parameter(1, "rays", "own", "returns a neural point contributes to the training set")
    near_samples: int = parameter(4, "samples/ray", "method notes", "samples around the return", low=0)
    near_sigma: float = parameter(
        0.25, "m", "method notes", "standard deviation of the near samples along the ray", low=0
    )
    front_samples: int = parameter(
        2, "samples/ray", "method notes", "samples in the free space before the return", low=0
    )
    front_reach: float = parameter(2.0, "m", "own", "free-space samples lie within this distance before the return")
    behind_samples: int = parameter(1, "samples/ray", "method notes", "samples behind the return", low=0)
    behind_reach: float = parameter(0.6, "m", "method notes", "samples behind lie within this distance")
    loss: Loss = parameter(Loss.BCE, "bce or l1", "PIN-SLAM", "loss on the signed distance")
    loss_scale: float = parameter(0.08, "m", "PIN-SLAM", "scale of the sigmoid of the bce loss")
    feature_decay: float = parameter(0.01, "1", "own", "weight of the squared latent features in the loss", low=0)
    fitting: Fitting = parameter(
        Fitting.AT_ONCE, "at once or scan by scan", "own; paper III-B 5: scan by scan", "when a learned field is fitted"
    )
    steps: int = parameter(
        10, "steps", "paper III-B 5", "gradient steps a submap, or a scan, of a learned field", low=0
    )
    batch: int = parameter(16384, "samples", "PIN-SLAM", "samples a gradient step")
    learning_rate: float = parameter(0.01, "1", "PIN-SLAM", "Adam step size")
    update_decoder: bool = parameter(False, "", "paper III-B 5", "also adapt the decoder of a learned field")
    dynamic_distance: float = parameter(
        0.3, "m", "paper Eq. 6, gamma_d", "a dynamic point lies farther from the surface", low=0
    )
    dynamic_stability: int = parameter(
        2, "scans", "paper Eq. 6, gamma_mu", "scans that must have seen free space where a dynamic point was"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.front_reach < self.truncation / 2:
            self.refuse("front_reach", f"must be at least half the truncation, {self.truncation:g}")


@dataclass(frozen=True)
class SurfaceConfig(Section):
    """Mesh, normals and occupancy out of the field (paper III-C)."""

    section: ClassVar[str] = "surface"

    observed_distance: float = parameter(
        0.6, "m", "method notes", "corners farther than this from every neural point are unobserved"
    )
    min_component: int = parameter(12, "vertices", "own", "connected mesh parts with fewer vertices are noise", low=0)
    min_returns: int = parameter(2, "returns", "own", "no-implicit ablation: returns an occupied voxel needs")


@dataclass(frozen=True)
class ClusterConfig(Section):
    """Ground removal and fast Euclidean clustering (paper III-C)."""

    section: ClassVar[str] = "clusters"

    ground_cosine: float = parameter(0.85, "1", "method notes", "|n_z| of ground vertices", low=0, high=1)
    ground_height: float = parameter(0.5, "m", "method notes", "ground lies this near the lower envelope", low=0)
    ground_cell: float = parameter(2.0, "m", "own", "edge of a column of the lower envelope")
    standing_height: float = parameter(0.7, "m", "own, decision 0008", "a low column of less extent is ground", low=0)
    ground_slope: float = parameter(
        0.03, "1", "own, decision 0008", "rise of the ground over its plane with distance", low=0
    )
    radius: float = parameter(0.8, "m", "method notes", "vertices nearer than this belong together")
    min_vertices: int = parameter(60, "vertices", "method notes", "smaller clusters are not dominant")


@dataclass(frozen=True)
class BevConfig(Section):
    """Cluster-guided BEV image and its features (paper III-D, III-E)."""

    section: ClassVar[str] = "bev"

    half_range: float = parameter(50.0, "m", "method notes", "the image covers +- this distance from the submap centre")
    cluster_distance: float = parameter(
        0.6, "m", "paper Eq. 7, delta_c", "voxels this near a dominant cluster are projected"
    )
    min_support: float = parameter(
        0.5, "1", "own", "share of the standing voxels below which all of them are projected", low=0, high=1
    )
    normalisation: Normalisation = parameter(
        Normalisation.LOG, "log, linear or binary", "paper Eq. 9, eta", "evidence to image intensity"
    )
    saturation_quantile: float = parameter(
        0.95, "1", "own", "occupied pixels above this quantile are white", low=0, high=1
    )
    scales: int = parameter(4, "1", "BVMatch", "scales of the log-Gabor filters", high=16)
    orientations: int = parameter(
        6, "1", "method notes", "orientations of the log-Gabor filters and of the histograms", high=127
    )
    wavelength: float = parameter(3.0, "px", "BVMatch", "wavelength of the finest filter", low=2)
    scale_factor: float = parameter(1.6, "1", "BVMatch", "ratio of the wavelengths of two scales", low=1)
    bandwidth: float = parameter(0.75, "1", "BVMatch", "sigma over centre frequency of the radial part", high=0.99)
    filter_margin: int = parameter(32, "px", "own", "empty border against wrap-around of the filters", low=0)
    keypoint_source: KeypointSource = parameter(
        KeypointSource.IMAGE, "image or mim", "BVMatch; paper III-D: mim", "where FAST looks for corners"
    )
    fast_threshold: int = parameter(10, "grey levels", "method notes", "contrast of a FAST corner", high=254)
    max_keypoints: int = parameter(200, "keypoints", "method notes", "the strongest corners are kept")
    min_keypoints: int = parameter(
        40, "keypoints", "own", "filled up with amplitude maxima where corners are fewer", low=0
    )
    context_px: int = parameter(
        138, "px", "method notes", "diameter of the disc that sets a keypoint's orientation", low=2, high=4096
    )
    patch_px: int = parameter(96, "px", "method notes", "edge of the described patch", high=4096)
    patch_step: int = parameter(2, "px", "own", "sampling distance inside the patch")
    cells: int = parameter(6, "1", "BVMatch", "parts of the patch along each edge", high=64)
    amplitude_power: float = parameter(
        0.5, "1", "own", "weight of a pixel is this power of its filter amplitude", low=0
    )
    layout_power: float = parameter(2.0, "1", "own, decision 0017", "intensities are raised to this power", low=0)
    layout_blur: float = parameter(1.0, "px", "own, decision 0017", "standard deviation of the blur", low=0)
    layout_radii: int = parameter(24, "1", "own, decision 0017", "frequencies of the layout spectrum")
    layout_angles: int = parameter(60, "1", "own, decision 0017", "angles of the layout spectrum over half a turn")
    layout_frequency: float = parameter(0.2, "cycles/px", "own, decision 0017", "highest frequency", high=0.5)
    layout_harmonics: int = parameter(
        6, "1", "own, decision 0017", "harmonics over the angle, beside their mean", low=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if max(self.cells, self.patch_step) > self.patch_px:
            self.refuse("patch_px", f"must be at least cells, {self.cells}, and patch_step, {self.patch_step}")
        if self.layout_harmonics > self.layout_angles // 2:
            self.refuse("layout_harmonics", f"must be at most half of layout_angles, {self.layout_angles}")


@dataclass(frozen=True)
class MicroConfig(Section):
    """Cluster normal statistics and saliency (paper III-C, III-E)."""

    section: ClassVar[str] = "micro"

    evaluation: Evaluation = parameter(
        Evaluation.KEYPOINT, "keypoint or cluster", "paper Fig. 2b; III-C: cluster", "where psi is evaluated"
    )
    radius: float = parameter(8.0, "m", "own", "column around a keypoint over which psi is evaluated")
    distance_bins: int = parameter(3, "1", "own; paper III-C: 1", "classes of pairs of regions by horizontal distance")
    height_bins: int = parameter(1, "1", "own; paper III-C: 1", "classes of pairs of regions by height difference")
    pairs_per_keypoint: int = parameter(60, "pairs", "paper III-C, n_m", "random pairs for each keypoint of a cluster")
    epsilon: float = parameter(
        0.5, "keypoints", "paper Eq. 12", "keeps the weight of clusters without keypoints positive"
    )


@dataclass(frozen=True)
class SpectrumConfig(Section):
    """Spectra of profiles along all headings: of faces (normal spectrum) and of the plan (plan spectrum)."""

    section: ClassVar[str] = "spectra"

    headings: int = parameter(72, "1", "own, decision 0017", "headings, over a turn for faces, over half for the plan")
    reach: float = parameter(65.0, "m", "own, decision 0017", "weights fall to zero at this distance")
    spacing: float = parameter(1.0, "m", "own, decision 0017", "bin of a profile")
    sharpness: float = parameter(
        4.0, "1", "own, decision 0017", "power of the cosine by which a face counts for a heading near its own", low=0
    )
    frequencies: int = parameter(24, "1", "own, decision 0017", "frequencies of a spectrum")
    highest: float = parameter(0.25, "cycles/m", "own, decision 0017", "highest frequency")
    harmonics: int = parameter(12, "1", "own, decision 0017", "harmonics over the heading, beside their mean", low=0)
    neighbours: int = parameter(
        1, "1", "own, decision 0017", "higher frequencies with which each one's harmonics are compared in phase", low=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.harmonics > self.headings // 2:
            self.refuse("harmonics", f"must be at most half of headings, {self.headings}")
        if self.neighbours >= self.frequencies:
            self.refuse("neighbours", f"must be less than frequencies, {self.frequencies}")
        if self.reach > self.spacing * PROFILE_BINS / 2:
            self.refuse("reach", f"must be at most {PROFILE_BINS // 2} times the spacing, {self.spacing:g}")
        if not 0.5 / self.reach <= self.highest < 0.5 / self.spacing:
            self.refuse("highest", f"must be at least {0.5 / self.reach:g} and less than {0.5 / self.spacing:g}")


@dataclass(frozen=True)
class FusionConfig(Section):
    """VLAD aggregation and fusion (paper III-D, III-E)."""

    section: ClassVar[str] = "fusion"

    local_size: int = parameter(64, "1", "own", "principal components kept of a patch histogram")
    macro_centres: int = parameter(128, "1", "own", "codebook size of the BEV patches")
    micro_centres: int = parameter(16, "1", "method notes", "codebook size of the cluster histograms")
    macro_size: int = parameter(196, "1", "own, decision 0017", "length of the BEV part")
    micro_size: int = parameter(30, "1", "own, decision 0017", "length of the VLAD of the cluster part")
    spectrum_size: int = parameter(330, "1", "own, decision 0017", "length of the normal spectrum in the cluster part")
    layout_size: int = parameter(168, "1", "own, decision 0017", "length of the layout part")
    plan_size: int = parameter(300, "1", "own, decision 0017", "length of the plan part")
    macro_weight: float = parameter(0.4, "1", "paper Eq. 14, lambda_B", "weight of the BEV part", low=0)
    micro_weight: float = parameter(0.7, "1", "paper Eq. 14, lambda_G", "weight of the cluster part", low=0)
    histogram_share: float = parameter(
        0.3, "1", "own, decision 0017", "weight of the VLAD beside the normal spectrum", low=0
    )
    spectrum_weight: float = parameter(
        1.0, "1", "own, decision 0017; paper: 0", "weight of the normal spectrum within the cluster part", low=0
    )
    layout_weight: float = parameter(0.7, "1", "own, decision 0017", "weight of the layout part", low=0)
    plan_weight: float = parameter(0.7, "1", "own, decision 0017", "weight of the plan part", low=0)
    literal_saliency: bool = parameter(False, "", "paper Eq. 13", "weigh cluster histograms before assignment")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.macro_weight + self.micro_weight + self.layout_weight + self.plan_weight:
            self.refuse("macro_weight", "and the other weights cannot all be 0")


@dataclass(frozen=True)
class AdaptationConfig(Section):
    """How descriptors are standardised by the places of their own map, without labels (decision 0120)."""

    section: ClassVar[str] = "adaptation"

    first_places: int = parameter(8, "places", "own, decision 0120", "fewer places of a map or session change nothing")
    growth: float = parameter(1.25, "1", "own, decision 0120", "statistics are learned anew after this growth")
    prior_places: float = parameter(20.0, "places", "own, decision 0120", "what the prior counts for", low=0)
    spread_floor: float = parameter(0.1, "1", "own, decision 0120", "share of the mean spread added to each", low=0)
    cell: float = parameter(5.0, "m", "own, decision 0120", "places of a session nearer than this count once")


@dataclass(frozen=True)
class LoopConfig(Section):
    """Which earlier submaps are candidates."""

    section: ClassVar[str] = "loop"

    leave_distance: float = parameter(
        5.0,
        "m",
        "own, decision 0316; paper IV-B: 50 submaps",
        "so far a drive must have been from a place, before it comes back, for a loop within the drive; half of tau",
        low=0,
    )
    drift: float = parameter(
        0.02, "1", "own, decision 0316", "by this share of the way between two submaps odometry may misplace them"
    )
    candidates: int = parameter(20, "submaps", "method notes", "nearest descriptors that are verified")
    enough: int = parameter(
        4,
        "loops",
        "own, decision 0161",
        "accepted loops of a submap that agree where another candidate lies, so that it is not compared; 0: all are",
        low=0,
    )


@dataclass(frozen=True)
class VerificationConfig(Section):
    """Geometric verification of a candidate (paper III-E, end)."""

    section: ClassVar[str] = "verification"

    spacing: float = parameter(0.8, "m", "own", "edge of the cubes of which a place keeps one surface point each")
    standing_points: int = parameter(2500, "points", "own", "most surface points off the ground in a place")
    ground_points: int = parameter(800, "points", "own", "most ground points in a place")
    min_standing: int = parameter(100, "points", "own", "a place with fewer points off the ground is degenerate", low=0)
    min_spread: float = parameter(
        0.5, "m", "own", "smallest horizontal standard deviation of a place that is no line", low=0
    )
    correspondences: int = parameter(160, "pairs", "own", "most similar pairs of keypoints that vote for a pose")
    keypoint_tolerance: float = parameter(1.2, "m", "own", "correspondences nearer than this agree with a pose")
    yaw_tolerance: float = parameter(
        25.0, "deg", "own", "largest error of the yaw that a correspondence implies", high=180
    )
    sure_inliers: int = parameter(25, "keypoints", "own", "below, poses by phase correlation are tried too", low=0)
    starts: int = parameter(2, "poses", "own, decision 0024", "most planar poses that are refined by ICP")
    correlation_pixel: float = parameter(0.8, "m", "own", "pixel of the images for phase correlation")
    correlation_turns: int = parameter(
        2, "yaws", "own, decision 0024", "yaws tried by phase correlation, each in both directions", low=0
    )
    opposite_share: float = parameter(
        0.95,
        "1",
        "own, decision 0024",
        "share of the best correlation from which on the opposite direction is one more start",
        low=0,
        high=1,
    )
    opposite_clear: float = parameter(
        0.6, "1", "own, decision 0024", "unless another turn reaches this share of it", low=0, high=1
    )
    coarse_rounds: int = parameter(10, "steps", "own", "coarse ICP steps", low=0)
    first_rounds: int = parameter(
        2, "steps", "own, decision 0024", "coarse ICP steps from each start, then the best goes on alone", low=0
    )
    coarse_share: int = parameter(5, "points", "own", "coarse steps use every so many-th point")
    coarse_distance: float = parameter(3.0, "m", "own", "reach of the coarse ICP steps")
    min_agreement: float = parameter(
        0.1, "1", "own, decision 0018", "share of points on the other surface below which ICP ends early", low=0
    )
    min_coarse_overlap: float = parameter(
        0.75,
        "1",
        "own, decision 0024",
        "part of min_overlap that the coarse steps must reach, else ICP ends early",
        low=0,
        high=1,
    )
    fine_rounds: int = parameter(6, "steps", "own", "ICP steps on all points", low=0)
    fine_distance: float = parameter(1.0, "m", "own", "reach of the fine ICP steps")
    neighbour_distance: float = parameter(1.0, "m", "own", "a surface point has its counterpart within this distance")
    surface_distance: float = parameter(0.25, "m", "own", "and lies this near to its tangent plane")
    contrast_shifts: tuple[float, ...] = parameter(
        (2.5, 4.0, 6.0), "m", "own, decision 0018", "moves along the weakest direction that a loop must not survive"
    )
    min_contrast: float = parameter(
        0.08,
        "1",
        "own, decision 0018",
        "smallest overlap that such a move must cost, else the pose is not fixed",
        low=0,
        high=1,
    )
    sight_angle: float = parameter(3.0, "deg", "own, decision 0018", "directions in which places have looked", high=90)
    sight_margin: float = parameter(2.0, "m", "own, decision 0018", "farther behind, it is looked through", low=0)
    sight_near: float = parameter(
        4.0, "m", "own, decision 0018", "nearer points look too different from scan to scan", low=0
    )
    sight_far: float = parameter(40.0, "m", "own, decision 0018", "farther points are too sparse to tell")
    max_seen_through: float = parameter(
        0.35,
        "1",
        "own, decision 0018",
        "largest share of what stands that the other place has looked through",
        low=0,
        high=1,
    )
    min_common: int = parameter(
        60, "points", "own", "standing points of each place in the region both have seen", low=0
    )
    min_common_share: float = parameter(
        0.35, "1", "own", "of the smaller place must stand in that region", low=0, high=1
    )
    min_common_share_sure: float = parameter(
        0.2,
        "1",
        "own, decision 0018",
        "the same where overlap and score are beyond doubt: sensors that see unlike parts of a place",
        low=0,
        high=1,
    )
    sure_overlap: float = parameter(0.4, "1", "own, decision 0018", "overlap beyond doubt", low=0, high=1)
    sure_score: float = parameter(0.95, "1", "own, decision 0018", "score beyond doubt", low=0, high=1)
    max_tilt: float = parameter(15.0, "deg", "own", "largest tilt between two gravity-aligned submaps", low=0, high=180)
    min_overlap: float = parameter(0.2, "1", "own, decision 0018", "smallest share of common surface", low=0, high=1)
    min_observability: float = parameter(0.002, "1", "own", "smallest eigenvalue share of the ICP information", low=0)
    lever: float = parameter(15.0, "m", "own", "lever arm at which rotations are compared with translations")
    min_sigma: float = parameter(0.03, "m", "own", "residuals are trusted no better than this")
    correlated_points: float = parameter(14.0, "points", "own, decision 0081", "points that share one error")
    systematic_horizontal: float = parameter(
        0.022, "m", "own, decision 0081", "standard deviation along x and y that more points do not lower", low=0
    )
    systematic_vertical: float = parameter(0.011, "m", "own, decision 0081", "the same along z", low=0)
    systematic_tilt: float = parameter(0.1, "deg", "own, decision 0081", "the same about x and y", low=0)
    systematic_yaw: float = parameter(0.055, "deg", "own, decision 0081", "the same about z", low=0)
    apart_horizontal: float = parameter(
        0.005, "1", "own, decision 0081", "standard deviation along x and y for each metre between the places", low=0
    )
    apart_vertical: float = parameter(0.003, "1", "own, decision 0081", "the same along z", low=0)
    apart_tilt: float = parameter(0.006, "deg/m", "own, decision 0081", "the same about x and y", low=0)
    apart_yaw: float = parameter(0.018, "deg/m", "own, decision 0081", "the same about z", low=0)
    systematic_direction: float = parameter(
        0.3,
        "deg",
        "own, decision 0081",
        "of the direction of travel as the sensor sees it, where its scans do not tell",
        low=0,
    )
    unshared_shift: float = parameter(
        0.04, "m", "own, decision 0081", "standard deviation along each axis where half of the surface is common", low=0
    )
    unshared_tilt: float = parameter(0.13, "deg", "own, decision 0081", "the same about x and y", low=0)
    unshared_yaw: float = parameter(0.09, "deg", "own, decision 0081", "the same about z", low=0)
    unshared_parts: float = parameter(
        2.0, "1", "own, decision 0081", "unshared surface a part of common one beyond which it counts in full", low=0
    )
    agreeing_surface: float = parameter(
        0.005, "m", "own, decision 0081", "what scans disagree by on surfaces that are as flat as simulated ones", low=0
    )
    disagreeing_surface: float = parameter(
        0.01, "m", "own, decision 0081", "disagreement beyond that from which on the deviations above count in full"
    )
    least_systematic: float = parameter(
        0.1, "1", "own, decision 0081", "share of the deviations above where scans agree", low=0, high=1
    )
    rival_distance: float = parameter(1.5, "m", "own, decision 0080", "poses farther apart than this are rivals")
    rival_nearest: float = parameter(
        0.6, "m", "own, decision 0080", "hypotheses of an ambiguous loop lie farther apart than this"
    )
    rival_near_share: float = parameter(
        0.95, "1", "own, decision 0080", "share of the overlap of those nearer than `rival_distance`", low=0
    )
    rival_common: float = parameter(
        0.5, "1", "own, decision 0080", "share of the common surface that a rival must have, too", low=0, high=1
    )
    rival_plan_share: float = parameter(
        0.85, "1", "own, decision 0080", "share of the coarse overlap from which on a rival is looked at", low=0, high=1
    )
    rival_starts: int = parameter(12, "poses", "own, decision 0080", "most rivals that are refined", low=0)
    rival_rounds: int = parameter(4, "steps", "own, decision 0080", "coarse ICP steps from each", low=0)
    rival_reach: float = parameter(1.5, "m", "own, decision 0080", "reach of these steps")
    rival_share: float = parameter(
        0.85, "1", "own, decision 0080", "share of the overlap from which on a rival makes a loop ambiguous", low=0
    )
    rival_repeats: float = parameter(
        0.65,
        "1",
        "own, decision 0340",
        "share of the overlap that both places must have with themselves a step on, to repeat by that step",
        low=0,
    )
    rival_repeats_share: float = parameter(
        0.7,
        "1",
        "own, decision 0340",
        "share of the overlap from which on a pose is a rival where both places repeat by the step to it",
        low=0,
    )
    rival_same_spot: float = parameter(
        0.85,
        "1",
        "own, decision 0340",
        "part of these shares and of rival_plan_share where both places were seen from one spot, and so alike",
        low=0,
    )
    support_anchors: int = parameter(
        2, "submaps", "own, decision 0161", "submaps beside an ambiguous loop whose accepted loops must agree with it"
    )
    support_length: float = parameter(
        15.0, "m", "own, decision 0161", "way of both drives over which the loops beside an ambiguous one must agree"
    )
    support_reach: float = parameter(
        60.0, "m", "own, decision 0161", "way along both drives together over which odometry carries a loop's pose"
    )
    support_tolerance: float = parameter(0.4, "m", "own, decision 0161", "by which a pose beside it may be off", low=0)
    support_drift: float = parameter(
        0.01, "1", "own, decision 0161", "and how much more for each metre that odometry carries it", low=0
    )
    support_turn: float = parameter(
        4.0, "deg", "own, decision 0161", "and by which its turn may be off", low=0, high=180
    )
    min_score: float = parameter(0.5, "1", "own", "smallest score of a verified loop", low=0, high=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sight_near >= self.sight_far:
            self.refuse("sight_near", f"must be less than sight_far, {self.sight_far:g}")


Overrides = Mapping[str, float | None]
"""Parameters of a section by name; None stands for the value that is in force anyway."""


@dataclass(frozen=True)
class PipelineConfig:
    """All parameters of the method.

    The method was built for streets. `scene_scale` is how large a scene is compared with one: lengths are divided by it
    after the submap is built, so that 0.25 makes rooms of 5 m look like streets of 20 m.
    """

    scene_scale: float = parameter(1.0, "1", "own, decision 0009", "size of the scene compared with a street")
    profile: Profile = parameter(
        Profile.PRODUCT, "product or paper", "own, decision 0122", "which models describe, as `profile_config` sets it"
    )
    submap: SubmapConfig = dataclasses.field(default_factory=SubmapConfig)
    implicit_map: ImplicitMapConfig = dataclasses.field(default_factory=ImplicitMapConfig)
    surface: SurfaceConfig = dataclasses.field(default_factory=SurfaceConfig)
    clusters: ClusterConfig = dataclasses.field(default_factory=ClusterConfig)
    bev: BevConfig = dataclasses.field(default_factory=BevConfig)
    micro: MicroConfig = dataclasses.field(default_factory=MicroConfig)
    spectra: SpectrumConfig = dataclasses.field(default_factory=SpectrumConfig)
    fusion: FusionConfig = dataclasses.field(default_factory=FusionConfig)
    adaptation: AdaptationConfig = dataclasses.field(default_factory=AdaptationConfig)
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    verification: VerificationConfig = dataclasses.field(default_factory=VerificationConfig)

    def __post_init__(self) -> None:
        scale = _checked("scene_scale", self.scene_scale, 1.0, {"low": 0.001, "high": 1000.0})
        resolution = self.implicit_map.resolution
        farthest = (self.submap.max_range + self.submap.tau) / scale
        if farthest / min(resolution, self.clusters.radius / 2) >= MAX_VOXEL:
            raise BadField("scene_scale is too small for the range and the resolution", field="scene_scale")
        if not 2 <= 2 * round(self.bev.half_range / resolution) <= MAX_IMAGE_PX:
            self.bev.refuse("half_range", f"must give an image of 2 to {MAX_IMAGE_PX} pixels of {resolution:g} m")

    def of_map(self, scene_scale: float, submap: Overrides, loop: Overrides, verification: Overrides) -> PipelineConfig:
        """These parameters with the overrides of a map, by name; None: as they are. Raises BadField, TypeError."""
        windows = dataclasses.replace(
            self.submap, **{"min_range": self.submap.min_range * scene_scale, **_given(submap)}
        )
        left_m = self.loop.leave_distance * windows.tau / self.submap.tau
        return dataclasses.replace(
            self,
            scene_scale=scene_scale,
            submap=windows,
            loop=dataclasses.replace(self.loop, **{"leave_distance": left_m, **_given(loop)}),
            verification=dataclasses.replace(self.verification, **_given(verification)),
        )


def _given(overrides: Overrides) -> dict[str, Any]:
    return {name: value for name, value in overrides.items() if value is not None}
