"""How two places lie to each other: SE(2) from the bird's-eye view, then ICP (paper III-E, end)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.place import Place
from revisit.core.verification.line_of_sight import seen_through

Array = NDArray[np.float32]
Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class PlanarFit:
    """A pose in the plane, T_match_query, and the keypoint correspondences that agree with it."""

    yaw: float
    translation: Array64
    inliers: int
    correspondences: int


@dataclass(frozen=True)
class Registration:
    """The outcome of ICP.

    T_match_query (4, 4); overlap 0..1, the share of standing surface in the region both have seen that lies on the
    other's surface, the mean of both directions; rmse_m of the point-to-plane residuals of the points that do;
    information (6, 6) in the tangent (x, y, z, rx, ry, rz) of the match frame, of unit variance residuals; common,
    the smaller number of standing points in the shared region; contrast, how much of the overlap is lost when the
    query is moved along the horizontal direction that the surfaces fix least: near 0 where any place along a street
    or hedge would fit as well; seen_through 0..1, the share of what stands in either place, as far as the other has
    looked there, that the other has looked through. Both are worst, 0 and 1, where ICP was given up early.
    """

    T_match_query: se3.Matrix4
    overlap: float
    rmse_m: float
    information: Array64
    common: int
    contrast: float
    seen_through: float


def correspond(query: Place, match: Place, limit: int) -> tuple[NDArray[np.int64], Array64]:
    """Pairs of keypoints (p, 2) whose patches are most alike, seen from either side, and the yaw (p,) each implies.

    At most `limit`, most alike first.
    A patch may look alike directly or turned by 180 degrees; the better of both decides about the yaw.
    """
    if len(query.keypoints) == 0 or len(match.keypoints) == 0:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    direct = query.descriptors @ match.descriptors.T
    turned = (query.descriptors * query.parity) @ match.descriptors.T
    likeness = np.maximum(direct, turned)
    forward = np.stack([np.arange(len(likeness)), likeness.argmax(axis=1)], axis=1)
    backward = np.stack([likeness.argmax(axis=0), np.arange(likeness.shape[1])], axis=1)
    pairs = np.unique(np.concatenate([forward, backward]), axis=0)
    pairs = pairs[np.argsort(-likeness[pairs[:, 0], pairs[:, 1]], kind="stable")][:limit]
    yaw = match.orientations[pairs[:, 1]].astype(np.float64) - query.orientations[pairs[:, 0]]
    return pairs, yaw + np.pi * (turned > direct)[pairs[:, 0], pairs[:, 1]]


def fit_plane_motion(query: Place, match: Place, config: VerificationConfig) -> PlanarFit:
    """The SE(2) pose that most correspondences agree with.

    Every two correspondences of compatible distance and yaw are tried, so nothing is random; the best pose is then
    refined by least squares on its inliers.
    """
    pairs, yaws = correspond(query, match, config.correspondences)
    source = query.keypoints[pairs[:, 0]].astype(np.float64)
    target = match.keypoints[pairs[:, 1]].astype(np.float64)
    best = _best_two_point_pose(source, target, yaws, config.keypoint_tolerance, np.radians(config.yaw_tolerance))
    yaw, translation = best[0], best[1:3]
    for _ in range(3):
        gaps = np.linalg.norm(_turned(source, yaw) + translation - target, axis=1)
        agree = (gaps < config.keypoint_tolerance) & (_wrapped(yaws - yaw) < np.radians(config.yaw_tolerance))
        if agree.sum() < 2:
            return PlanarFit(yaw, translation, int(agree.sum()), len(pairs))
        yaw, translation = _least_squares_motion(source[agree], target[agree])
    distinct = min(len(np.unique(pairs[agree, 0])), len(np.unique(pairs[agree, 1])))
    return PlanarFit(yaw, translation, distinct, len(pairs))


def correlate_images(query: Place, match: Place, config: VerificationConfig) -> list[PlanarFit]:
    """SE(2) poses by phase correlation of coarse BEV images, most similar first.

    The yaw comes from the amplitude spectra, which do not depend on the translation; then the translation by
    correlation, for both directions of the yaw.
    """
    pixel = config.correlation_pixel
    match_image = _raster(match.points[: match.standing_count, :2].astype(np.float64), pixel)
    query_points = query.points[: query.standing_count, :2].astype(np.float64)
    match_spectrum = fft.fft2(match_image)
    turns = _spectrum_turns(_polar_amplitude(fft.fft2(_raster(query_points, pixel))), _polar_amplitude(match_spectrum))
    fits = []
    for turn in turns[: config.correlation_turns]:
        for yaw in (turn, turn + np.pi):
            image = _raster(_turned(query_points, yaw), pixel)
            surface = fft.ifft2(match_spectrum * np.conj(fft.fft2(image))).real
            row, column = np.unravel_index(int(surface.argmax()), surface.shape)
            shift = (np.array([column, row], dtype=np.float64) + _HALF) % _SIZE - _HALF
            norm = float(np.linalg.norm(image) * np.linalg.norm(match_image))
            fits.append((float(surface[row, column]) / max(norm, 1e-12), yaw, shift * pixel))
    fits.sort(key=lambda fit: -fit[0])
    return [PlanarFit(float(yaw), translation, 0, 0) for _, yaw, translation in fits]


def lift(fit: PlanarFit, query: Place, match: Place) -> se3.Matrix4:
    """The planar pose as a transform, z by the median difference of the lowest points of the cells both have seen."""
    T_match_query = se3.from_yaw(fit.yaw, (*fit.translation, 0.0))
    heights = _lowest(match.points.astype(np.float64)), _lowest(se3.apply(T_match_query, query.points))
    cells, rows, columns = np.intersect1d(heights[0][0], heights[1][0], return_indices=True)
    if len(cells):
        T_match_query[2, 3] = float(np.median(heights[0][1][rows] - heights[1][1][columns]))
    return T_match_query


def register(starts: Sequence[se3.Matrix4], query: Place, match: Place, config: VerificationConfig) -> Registration:
    """Point-to-plane ICP from coarse to fine, and what the result is worth.

    All starts are approached with few points; only the one on which most of them agree is refined, and not even that
    one where less than `min_agreement` of them do: most candidates are no loops, and this is where they cost time.
    """
    tree = cKDTree(match.points)
    approached = [_approach(start, query, match, tree, config) for start in starts]
    T_match_query, agreement = max(approached, key=lambda pose: pose[1])
    if agreement < config.min_agreement:
        return _assess(T_match_query, query, match, tree, config)
    T_match_query = _iterate(T_match_query, query, match, tree, 1, config.fine_distance, config.fine_rounds)
    registration = _assess(T_match_query, query, match, tree, config)
    return dataclasses.replace(
        registration,
        contrast=_contrast(registration, query, match, tree, config),
        seen_through=_seen_through(T_match_query, query, match, config),
    )


def _approach(
    T_start: se3.Matrix4, query: Place, match: Place, tree: cKDTree, config: VerificationConfig
) -> tuple[se3.Matrix4, float]:
    """A coarsely refined start and the share of the points used that then lie on the other surface, facing alike."""
    share, reach = config.coarse_share, config.coarse_distance
    T_match_query = _iterate(T_start, query, match, tree, share, reach, config.coarse_rounds)
    moved = se3.apply(T_match_query, query.points[::share])
    normals = query.normals[::share] @ T_match_query[:3, :3].T
    other, other_normals = match.points.astype(np.float64), match.normals.astype(np.float64)
    hits, _, _ = _on_surface(moved, normals, other, other_normals, tree, config)
    return T_match_query, float(hits.mean())


def _iterate(
    T_match_query: se3.Matrix4,
    query: Place,
    match: Place,
    tree: cKDTree,
    share: int,
    reach: float,
    rounds: int,
) -> se3.Matrix4:
    """Up to `rounds` Gauss-Newton steps on every `share`-th point, with counterparts within `reach` metres."""
    source = query.points[::share].astype(np.float64)
    normals = query.normals[::share].astype(np.float64)
    for _ in range(rounds):
        step = _icp_step(T_match_query, source, normals, match, tree, reach)
        if step is None:
            break
        T_match_query = se3.exp(step) @ T_match_query
        if np.linalg.norm(step[:3]) < 2e-3 and np.linalg.norm(step[3:]) < 1e-4:
            break
    return T_match_query


def observability(information: Array64, lever_m: float) -> float:
    """The smallest eigenvalue share of an information matrix (6, 6), rotations measured at `lever_m`.

    Near 0 where the surfaces do not fix the pose (a corridor, a plane); at most 1/6.
    """
    scale = np.diag([1.0, 1.0, 1.0, *([1.0 / lever_m] * 3)])
    eigenvalues = np.linalg.eigvalsh(scale @ information @ scale)
    return float(max(eigenvalues[0], 0.0) / max(eigenvalues.sum(), 1e-12))


_SIZE = 128
_HALF = _SIZE // 2


def _turned(points: Array64, yaw: float) -> Array64:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]))


def _wrapped(angles: Array64) -> Array64:
    """The absolute value of angles brought into [-pi, pi)."""
    return np.abs((angles + np.pi) % (2.0 * np.pi) - np.pi)


def _least_squares_motion(source: Array64, target: Array64) -> tuple[float, Array64]:
    """The rotation and translation in the plane that map source (n, 2) to target (n, 2) best."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    yaw = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    return yaw, target.mean(axis=0) - _turned(source.mean(axis=0)[None], yaw)[0]


@numba.njit(cache=True)
def _best_two_point_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float
) -> Array64:
    best = np.zeros(4)
    count = len(source)
    for i in range(count):
        for j in range(i + 1, count):
            sx, sy = source[j, 0] - source[i, 0], source[j, 1] - source[i, 1]
            tx, ty = target[j, 0] - target[i, 0], target[j, 1] - target[i, 1]
            length = np.sqrt(sx * sx + sy * sy)
            if length < 4.0 * tolerance or abs(length - np.sqrt(tx * tx + ty * ty)) > tolerance:
                continue
            yaw = np.arctan2(sx * ty - sy * tx, sx * tx + sy * ty)
            if abs((yaws[i] - yaw + np.pi) % (2 * np.pi) - np.pi) > yaw_tolerance:
                continue
            if abs((yaws[j] - yaw + np.pi) % (2 * np.pi) - np.pi) > yaw_tolerance:
                continue
            c, s = np.cos(yaw), np.sin(yaw)
            mx, my = 0.5 * (source[i, 0] + source[j, 0]), 0.5 * (source[i, 1] + source[j, 1])
            x = 0.5 * (target[i, 0] + target[j, 0]) - (c * mx - s * my)
            y = 0.5 * (target[i, 1] + target[j, 1]) - (s * mx + c * my)
            agree = 0.0
            for k in range(count):
                dx = c * source[k, 0] - s * source[k, 1] + x - target[k, 0]
                dy = s * source[k, 0] + c * source[k, 1] + y - target[k, 1]
                if dx * dx + dy * dy > tolerance * tolerance:
                    continue
                if abs((yaws[k] - yaw + np.pi) % (2 * np.pi) - np.pi) < yaw_tolerance:
                    agree += 1.0
            if agree > best[3]:
                best[0], best[1], best[2], best[3] = yaw, x, y, agree
    return best


def _raster(points: Array64, pixel: float) -> Array64:
    """Points (n, 2) as a smoothed, mean-free density image of 128 x 128 pixels around the origin."""
    cells = np.floor(points / pixel).astype(np.int64) + _HALF
    inside = ((cells >= 0) & (cells < _SIZE)).all(axis=1)
    counts = np.bincount(cells[inside, 1] * _SIZE + cells[inside, 0], minlength=_SIZE * _SIZE).astype(np.float64)
    image = np.log1p(counts).reshape(_SIZE, _SIZE)
    image = image + 0.5 * (np.roll(image, 1, 0) + np.roll(image, -1, 0) + np.roll(image, 1, 1) + np.roll(image, -1, 1))
    return np.asarray(image - image.mean())


def _polar_amplitude(spectrum: NDArray[np.complex128]) -> Array64:
    """The amplitude of a spectrum over angle (180 steps of 1 degree) and radius, each ring free of its mean."""
    amplitude = np.log1p(np.abs(fft.fftshift(spectrum)))
    angle = np.radians(np.arange(180.0))[:, None]
    radius = np.arange(3.0, 45.0)[None, :]
    polar = map_coordinates(amplitude, [_HALF + radius * np.sin(angle), _HALF + radius * np.cos(angle)], order=1)
    return np.asarray(polar - polar.mean(axis=0))


def _spectrum_turns(query: Array64, match: Array64) -> list[float]:
    """Yaws of T_match_query in [0, pi) where the polar amplitudes agree, best first, at least 8 degrees apart."""
    product = fft.fft(match, axis=0) * np.conj(fft.fft(query, axis=0))
    agreement = fft.ifft(product, axis=0).real.sum(axis=1)
    turns: list[int] = []
    for turn in np.argsort(-agreement, kind="stable"):
        if all(min(abs(turn - other), 180 - abs(turn - other)) >= 8 for other in turns):
            turns.append(int(turn))
        if len(turns) == 6:
            break
    return [float(np.radians(turn)) for turn in turns]


def _cell_keys(points: Array64, edge: float = 2.0) -> NDArray[np.int64]:
    cells = np.floor(points[:, :2] / edge).astype(np.int64)
    return np.asarray((cells[:, 0] << 32) + cells[:, 1])


def _lowest(points: Array64) -> tuple[NDArray[np.int64], Array64]:
    """The occupied 2 m cells of points (n, 3) and their lowest height."""
    keys = _cell_keys(points)
    order = np.lexsort((points[:, 2], keys))
    cells, first = np.unique(keys[order], return_index=True)
    return cells, points[order][first, 2]


def _icp_step(
    T_match_query: se3.Matrix4,
    source: Array64,
    source_normals: Array64,
    match: Place,
    tree: cKDTree,
    distance: float,
) -> Array64 | None:
    """One Gauss-Newton step (6,) in the match frame, or None where too little agrees."""
    moved = se3.apply(T_match_query, source)
    gaps, nearest = tree.query(moved, distance_upper_bound=distance)
    found = np.isfinite(gaps)
    found[found] &= (
        np.einsum("ij,ij->i", source_normals[found] @ T_match_query[:3, :3].T, match.normals[nearest[found]]) > 0.5
    )
    if found.sum() < 30:
        return None
    moved, normals = moved[found], match.normals[nearest[found]].astype(np.float64)
    residuals = np.einsum("ij,ij->i", moved - match.points[nearest[found]], normals)
    weights = 1.0 / (1.0 + (residuals / (0.2 * distance)) ** 2) ** 2
    jacobian = np.concatenate([normals, np.cross(moved, normals)], axis=1)
    weighted = jacobian * weights[:, None]
    hessian = weighted.T @ jacobian
    damping = 1e-6 * np.trace(hessian) / 6.0 * np.eye(6)
    return np.asarray(-np.linalg.solve(hessian + damping, weighted.T @ residuals))


def _assess(
    T_match_query: se3.Matrix4, query: Place, match: Place, tree: cKDTree, config: VerificationConfig
) -> Registration:
    moved = se3.apply(T_match_query, query.points)
    moved_normals = query.normals @ T_match_query[:3, :3].T
    match_points, match_normals = match.points.astype(np.float64), match.normals.astype(np.float64)
    forward, residuals, rows = _on_surface(moved, moved_normals, match_points, match_normals, tree, config)
    backward, _, _ = _on_surface(match_points, match_normals, moved, moved_normals, cKDTree(moved), config)
    seen_query = _in_region(moved[: query.standing_count], match_points)
    seen_match = _in_region(match_points[: match.standing_count], moved)
    overlap = 0.5 * (
        _share(forward[: query.standing_count] & seen_query, seen_query)
        + _share(backward[: match.standing_count] & seen_match, seen_match)
    )
    normals = match_normals[rows]
    jacobian = np.concatenate([normals, np.cross(moved[forward], normals)], axis=1)
    rmse = float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float(config.surface_distance)
    common = int(min(seen_query.sum(), seen_match.sum()))
    return Registration(T_match_query, overlap, rmse, jacobian.T @ jacobian, common, contrast=0.0, seen_through=1.0)


def _contrast(
    registration: Registration,
    query: Place,
    match: Place,
    tree: cKDTree,
    config: VerificationConfig,
) -> float:
    """The overlap of the standing query surface, less the largest one at a pose moved along the weakest direction."""
    weakest = np.linalg.eigh(registration.information[:2, :2])[1][:, 0]
    T = registration.T_match_query
    moved = se3.apply(T, query.points[: query.standing_count])
    normals = query.normals[: query.standing_count] @ T[:3, :3].T
    points, point_normals = match.points.astype(np.float64), match.normals.astype(np.float64)

    def overlap(shift_m: float) -> float:
        shifted = moved + np.array([*(shift_m * weakest), 0.0])
        seen = _in_region(shifted, points)
        hits, _, _ = _on_surface(shifted, normals, points, point_normals, tree, config)
        return _share(hits & seen, seen)

    return overlap(0.0) - max(overlap(sign * shift) for shift in config.contrast_shifts for sign in (-1.0, 1.0))


def _seen_through(T_match_query: se3.Matrix4, query: Place, match: Place, config: VerificationConfig) -> float:
    """The share of what stands in either place, where the other tells anything of it, that the other looked through."""
    moved = se3.apply(T_match_query, query.points[: query.standing_count])
    back = se3.apply(se3.inverse(T_match_query), match.points[: match.standing_count])
    by_match = seen_through(moved, match.points.astype(np.float64), config)
    by_query = seen_through(back, query.points.astype(np.float64), config)
    return (by_match[0] + by_query[0]) / max(by_match[1] + by_query[1], 1)


def _share(hits: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    return float(hits.sum()) / max(int(of.sum()), 1)


def _in_region(points: Array64, seen: Array64) -> NDArray[np.bool_]:
    """Which points (n, 3) stand in a 2 m column in which the other place has seen anything."""
    return np.isin(_cell_keys(points), np.unique(_cell_keys(seen)))


def _on_surface(
    points: Array64,
    normals: Array64,
    other: Array64,
    other_normals: Array64,
    tree: cKDTree,
    config: VerificationConfig,
) -> tuple[NDArray[np.bool_], Array64, NDArray[np.int64]]:
    """Which points (n, 3) lie on the other surface: near one of its points, near its tangent plane, facing alike.

    Also the plane residuals (k,) metres and the rows (k,) of `other` for those that do.
    """
    gaps, nearest = tree.query(points, distance_upper_bound=config.neighbour_distance)
    found = np.flatnonzero(np.isfinite(gaps))
    rows = nearest[found]
    residuals = np.einsum("ij,ij->i", points[found] - other[rows], other_normals[rows])
    facing = np.einsum("ij,ij->i", normals[found], other_normals[rows])
    good = (np.abs(residuals) < config.surface_distance) & (facing > 0.6)
    on = np.zeros(len(points), dtype=bool)
    on[found[good]] = True
    return on, residuals[good], rows[good]
