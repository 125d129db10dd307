"""Pre-training of the shared SDF decoder (docs/decisions/0115).

The decoder is trained for the way it is used: in every episode the latent features of one submap start at zero and take
the same few Adam steps as in `core.implicit_map.gradient_steps.fit_features` with the decoder frozen; then the decoder
takes one step on a fresh batch at the adapted features (first-order meta-learning).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map.decoder import DecoderWeights
from revisit.core.implicit_map.fitting import accumulate, without_dynamic_points
from revisit.core.implicit_map.gradient_steps import decoder_of, fit_features, predict, sdf_loss, tensors_of
from revisit.core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from revisit.core.implicit_map.samples import draw_samples
from revisit.core.implicit_map.settled import settle
from revisit.core.kernels.neighbour_blend import ENCODING_SIZE
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.voxel_table import table_of, voxels_of
from revisit.core.submap import Submap


@dataclass(frozen=True)
class TrainingSet:
    """Neighbourhoods and labels (m,) metres of one submap's samples, and its number of neural points."""

    near: Neighbourhood
    labels: NDArray[np.float32]
    count: int


def training_set(submap: Submap, config: ImplicitMapConfig, rng: np.random.Generator) -> TrainingSet:
    """The samples that fitting would draw from `submap`."""
    points = settle(without_dynamic_points(accumulate(submap, config), submap, config), config.resolution)
    table = table_of(voxels_of(points.positions, config.resolution))
    samples = draw_samples(submap.points, submap.origins[submap.scan_index], points, table, config, rng)
    columns = columns_of(points.positions, config.resolution)
    near = find_neighbourhood(samples.positions, points.positions, points.normals, columns, config)
    usable = np.flatnonzero(np.isfinite(near.nearest))
    return TrainingSet(near[usable], samples.labels[usable], len(points))


def initial_decoder(config: ImplicitMapConfig, width: int, hidden_layers: int, seed: int) -> DecoderWeights:
    """He-initialised hidden layers and a zero output layer: training starts at the tangent planes."""
    rng = np.random.default_rng(seed)
    sizes = [config.feature_size + ENCODING_SIZE, *[width] * hidden_layers]
    matrices = [
        rng.normal(0, np.sqrt(2 / fan_in), (fan_out, fan_in)).astype(np.float32)
        for fan_in, fan_out in itertools.pairwise(sizes)
    ]
    biases = [np.zeros(size, dtype=np.float32) for size in sizes[1:]]
    return DecoderWeights((*matrices, np.zeros((1, width), dtype=np.float32)), (*biases, np.zeros(1, dtype=np.float32)))


def train_decoder(
    sets: list[TrainingSet], start: DecoderWeights, config: ImplicitMapConfig, episodes: int, seed: int
) -> tuple[DecoderWeights, list[float]]:
    """Meta-train `start` on `sets`; returns the decoder and the outer loss of every episode."""
    rng = np.random.default_rng(seed)
    parameters = [tensor.requires_grad_(True) for tensor in tensors_of(start)]
    optimiser = torch.optim.Adam(parameters, lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, episodes)
    losses: list[float] = []
    for _ in range(episodes):
        chosen = sets[rng.integers(len(sets))]
        frozen = decoder_of(parameters)
        nothing = np.zeros((chosen.count, frozen.feature_size), np.float32)
        features, _ = fit_features(chosen.near, chosen.labels, nothing, frozen, config, rng)
        batch = rng.integers(0, len(chosen.labels), config.batch)
        optimiser.zero_grad()
        predicted = predict(parameters, torch.from_numpy(features), chosen.near[batch])
        loss = sdf_loss(predicted, torch.from_numpy(chosen.labels[batch]), config)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        losses.append(float(loss.detach()))
    return decoder_of(parameters), losses
