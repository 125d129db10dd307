"""Fitting: a submap's scans -> neural points without moving objects -> their field (paper III-B 3 to 5)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import Field, Fitting, ImplicitMapConfig
from revisit.core.implicit_map.decoder import DecoderWeights
from revisit.core.implicit_map.neighbourhood import find_neighbourhood
from revisit.core.implicit_map.neural_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints, oriented
from revisit.core.implicit_map.settled import settle
from revisit.core.implicit_map.visibility import by_scan, count_seen_through
from revisit.core.kernels.gathered_returns import GatheredReturns
from revisit.core.kernels.point_columns import columns_of
from revisit.core.stages import stage
from revisit.core.submap import Submap

Array = NDArray[np.float32]

GATHERED_SHARE = 3
"""So many times the neural points that a map may have are gathered before the farthest are left out."""


@stage("implicit_map")
def fit_implicit_map(
    submap: Submap, decoder: DecoderWeights, config: ImplicitMapConfig, rng: np.random.Generator
) -> NeuralMap:
    """The neural map of a submap: accumulate, remove moving objects, fit features where the field is learned."""
    gathered = gather(submap, config)
    crowded = len(gathered) > config.max_points
    points = oriented(gathered, config.resolution, config.max_points)
    del gathered  # room for later steps
    points = without_dynamic_points(points, submap, config)
    points = settle(points, config.resolution)
    if config.field is Field.PLANES:
        return dataclasses.replace(NeuralMap.of_planes(points, submap.stamps_ns, config), crowded=crowded)
    features, fitted = _learned(submap, points, decoder, config, rng)
    return NeuralMap(points, features, submap.stamps_ns, fitted, config, adapted=config.update_decoder, crowded=crowded)


def _learned(
    submap: Submap, points: NeuralPoints, decoder: DecoderWeights, config: ImplicitMapConfig, rng: np.random.Generator
) -> tuple[Array, DecoderWeights]:
    """Features (n, F) of `points`, and the decoder they are for; torch is imported, and only here."""
    if config.fitting is Fitting.SCAN_BY_SCAN:
        from revisit.core.implicit_map.online_fitting import learn_online

        return learn_online(submap, points, GATHERED_SHARE * config.max_points, decoder, config, rng)
    from revisit.core.implicit_map.gradient_steps import learn_features

    origins = submap.origins[submap.scan_index]
    features = np.zeros((len(points), decoder.feature_size), np.float32)
    return learn_features(submap.points, origins, points, features, decoder, config, rng)


def accumulate(submap: Submap, config: ImplicitMapConfig) -> NeuralPoints:
    """The elastic neural points of all scans, in time order (paper III-B 3)."""
    return oriented(gather(submap, config), config.resolution)


def gather(submap: Submap, config: ImplicitMapConfig) -> NDArray[np.float64]:
    """The returns of all scans, gathered in time order: at most GATHERED_SHARE times the points of a map."""
    gathered = GatheredReturns(config.resolution, len(submap.points), GATHERED_SHARE * config.max_points)
    scans = by_scan(submap.points, submap.scan_index, len(submap.origins))
    for number, (seen, origin) in enumerate(zip(scans, submap.origins, strict=True)):
        gathered.insert(seen, origin, number)
    return gathered.records


def without_dynamic_points(points: NeuralPoints, submap: Submap, config: ImplicitMapConfig) -> NeuralPoints:
    """Remove the neural points of moving objects (paper III-B 4, Eq. 6).

    H(p), the temporal consistency, is the number of scans that saw free space where the point is; S(p) is its distance
    from the surface of the points that were never seen through. The stability mu of the rest is hits minus H.
    """
    seen_through = count_seen_through(points.positions, submap.points, submap.scan_index, submap.origins)
    stability = points.hits.astype(np.float32) - seen_through
    suspect = (seen_through >= config.dynamic_stability) & (stability <= 0)
    dynamic = suspect.copy()
    consistent = seen_through == 0
    if suspect.any() and consistent.any():
        stable = np.flatnonzero(consistent)
        positions, normals = points.positions.take(stable, axis=0), points.normals.take(stable, axis=0)
        columns = columns_of(positions, config.resolution)
        near = find_neighbourhood(points.positions[suspect], positions, normals, columns, config)
        # free space without any surface near is far from it
        far = (near.plane_distance > config.dynamic_distance) | ~np.isfinite(near.nearest)
        dynamic[suspect] = far  # Eq. 6: S(p) > gamma_d, and H(p) > gamma_mu of the suspects
    return dataclasses.replace(points, stability=stability).subset(~dynamic)
