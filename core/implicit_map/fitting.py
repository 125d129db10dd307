"""Fitting: a submap's scans -> neural points without moving objects -> latent features (paper III-B 3 to 5)."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from revisit.core.config import ImplicitMapConfig, Loss
from revisit.core.implicit_map.decoder import DecoderWeights, decode
from revisit.core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from revisit.core.implicit_map.neural_map import NeuralMap
from revisit.core.implicit_map.neural_points import ElasticAccumulator, NeuralPoints
from revisit.core.implicit_map.samples import draw_samples
from revisit.core.implicit_map.settled import settle
from revisit.core.implicit_map.visibility import count_seen_through
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.voxel_table import table_of, voxels_of
from revisit.core.stages import stage
from revisit.core.submap import Submap

Array = NDArray[np.float32]


@stage("implicit_map")
def fit_implicit_map(
    submap: Submap, decoder: DecoderWeights, config: ImplicitMapConfig, rng: np.random.Generator
) -> NeuralMap:
    """The neural map of a submap: accumulate, remove what moved, fit the latent features (paper III-B)."""
    points = settle(without_dynamic_points(accumulate(submap, config), submap, config), config.resolution)
    table = table_of(voxels_of(points.positions, config.resolution))
    samples = draw_samples(submap.points, submap.origins[submap.scan_index], points, table, config, rng)
    columns = columns_of(points.positions, config.resolution)
    near = find_neighbourhood(samples.positions, points.positions, points.normals, columns, config)
    features, fitted = fit_features(near, samples.labels, len(points), decoder, config, rng)
    return NeuralMap(points, features, submap.stamps_ns, fitted, config, adapted=config.update_decoder)


def accumulate(submap: Submap, config: ImplicitMapConfig) -> NeuralPoints:
    """The elastic neural points of all scans, in time order (paper III-B 3)."""
    accumulator = ElasticAccumulator(config.resolution, len(submap.points))
    bounds = np.searchsorted(submap.scan_index, np.arange(submap.scan_count + 1))
    for scan in range(submap.scan_count):
        accumulator.insert(submap.points[bounds[scan] : bounds[scan + 1]], submap.origins[scan], scan)
    return accumulator.finish()


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
        stable = points.subset(consistent)
        columns = columns_of(stable.positions, config.resolution)
        near = find_neighbourhood(points.positions[suspect], stable.positions, stable.normals, columns, config)
        # free space without any surface near is far from it
        far = (near.plane_distance > config.dynamic_distance) | ~np.isfinite(near.nearest)
        dynamic[suspect] = far  # Eq. 6: S(p) > gamma_d, and H(p) > gamma_mu of the suspects
    return dataclasses.replace(points, stability=stability).subset(~dynamic)


def fit_features(
    near: Neighbourhood,
    labels: Array,
    count: int,
    decoder: DecoderWeights,
    config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> tuple[Array, DecoderWeights]:
    """A fixed number of Adam steps on the latent features of `count` neural points (paper III-B 5).

    `near` and `labels` (m,) metres are the training set. The decoder stays frozen unless `config.update_decoder`.
    Returns features (count, F) float32 and the decoder.
    """
    usable = np.flatnonzero(np.isfinite(near.nearest))
    features = torch.zeros((count, decoder.feature_size), requires_grad=True)
    parameters = [tensor.requires_grad_(config.update_decoder) for tensor in decoder.tensors()]
    trained = [features, *(parameters if config.update_decoder else [])]
    optimiser = torch.optim.Adam(trained, lr=config.learning_rate)
    for _ in range(config.steps if len(usable) else 0):
        batch = usable[rng.integers(0, len(usable), config.batch)] if len(usable) > config.batch else usable
        optimiser.zero_grad()
        predicted = predict(parameters, features, near[batch])
        loss = sdf_loss(predicted, torch.from_numpy(labels[batch]), config)
        (loss + config.feature_decay * features.square().sum(dim=1).mean()).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    fitted = DecoderWeights.from_tensors(parameters) if config.update_decoder else decoder
    return features.detach().numpy(), fitted


def predict(parameters: list[Tensor], features: Tensor, near: Neighbourhood) -> Tensor:
    """Signed distances (m,) metres of a neighbourhood, differentiable in the features (n, F) and the decoder."""
    blended = torch.nn.functional.embedding_bag(  # Eq. 4
        torch.from_numpy(near.indices), features, per_sample_weights=torch.from_numpy(near.weights), mode="sum"
    )
    return decode(parameters, blended, torch.from_numpy(near.encoding), torch.from_numpy(near.plane_distance))


def sdf_loss(predicted: Tensor, labels: Tensor, config: ImplicitMapConfig) -> Tensor:
    """Mean loss of predicted against labelled signed distances, both (m,) metres.

    `Loss` says which losses there are.
    """
    if config.loss is Loss.L1:
        return (predicted.clamp(-config.truncation, config.truncation) - labels).abs().mean()
    return torch.nn.functional.binary_cross_entropy_with_logits(
        predicted / config.loss_scale, torch.sigmoid(labels / config.loss_scale)
    )
