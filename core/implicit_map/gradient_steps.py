"""Gradient steps on the latent features of a learned field (paper III-B 5); the home of torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MissingLibrary

try:
    import torch
    from torch import Tensor
except ModuleNotFoundError as missing:
    hint = "a learned field is fitted with torch, which is not installed: pip install 'revisit-loops[learned]'"
    raise MissingLibrary(hint, name="torch") from missing

from revisit.core.config import ImplicitMapConfig, Loss
from revisit.core.implicit_map.decoder import DecoderWeights
from revisit.core.implicit_map.neighbourhood import Neighbourhood, find_neighbourhood
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.samples import draw_samples
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.voxel_table import table_of, voxels_of

Array = NDArray[np.float32]


def learn_features(
    returns: Array,
    origins: Array,
    points: NeuralPoints,
    features: Array,
    decoder: DecoderWeights,
    config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> tuple[Array, DecoderWeights]:
    """The `features` (n, F) of `points` after the steps, and the decoder they are for.

    The training set is drawn along the rays to `returns` (m, 3) from `origins` (m, 3). Features of points that are no
    neighbour of a sample stay as they are.
    """
    table = table_of(voxels_of(points.positions, config.resolution))
    samples = draw_samples(returns, origins, points, table, config, rng)
    columns = columns_of(points.positions, config.resolution)
    near = find_neighbourhood(samples.positions, points.positions, points.normals, columns, config)
    involved = np.unique(near.indices[near.weights > 0])
    place = np.zeros(len(points), np.int64)
    place[involved] = np.arange(len(involved))
    near, learned = replace(near, indices=place[near.indices]), features.copy()
    learned[involved], decoder = fit_features(near, samples.labels, features[involved], decoder, config, rng)
    return learned, decoder


def tensors_of(decoder: DecoderWeights) -> list[Tensor]:
    """Matrix, bias, matrix, bias, ... as torch tensors (copies)."""
    pairs = zip(decoder.matrices, decoder.biases, strict=True)
    return [torch.tensor(array) for pair in pairs for array in pair]


def decoder_of(tensors: list[Tensor]) -> DecoderWeights:
    """The inverse of `tensors_of`."""
    arrays = [tensor.detach().numpy().astype(np.float32) for tensor in tensors]
    return DecoderWeights(tuple(arrays[0::2]), tuple(arrays[1::2]))


def fit_features(
    near: Neighbourhood,
    labels: Array,
    start: Array,
    decoder: DecoderWeights,
    config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> tuple[Array, DecoderWeights]:
    """A fixed number of Adam steps from the latent features `start` (n, F) of neural points (paper III-B 5).

    `near` and `labels` (m,) metres are the training set. The decoder stays frozen unless `config.update_decoder`.
    Returns features (n, F) float32 and the decoder.
    """
    usable = np.flatnonzero(np.isfinite(near.nearest))
    features = torch.tensor(start, requires_grad=True)
    parameters = [tensor.requires_grad_(config.update_decoder) for tensor in tensors_of(decoder)]
    trained = [features, *(parameters if config.update_decoder else [])]
    optimiser = torch.optim.Adam(trained, lr=config.learning_rate)
    for _ in range(config.steps if len(usable) else 0):
        batch = usable[rng.integers(0, len(usable), config.batch)] if len(usable) > config.batch else usable
        optimiser.zero_grad()
        predicted = predict(parameters, features, near[batch])
        loss = sdf_loss(predicted, torch.from_numpy(labels[batch]), config)
        (loss + config.feature_decay * features.square().sum(dim=1).mean()).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    fitted = decoder_of(parameters) if config.update_decoder else decoder
    return features.detach().numpy(), fitted


def predict(parameters: list[Tensor], features: Tensor, near: Neighbourhood) -> Tensor:
    """Signed distances (m,) metres of a neighbourhood, differentiable in the features (n, F) and the decoder."""
    blended = torch.nn.functional.embedding_bag(  # Eq. 4
        torch.from_numpy(near.indices), features, per_sample_weights=torch.from_numpy(near.weights), mode="sum"
    )
    hidden = torch.cat([blended, torch.from_numpy(near.encoding)], dim=1)
    for layer in range(0, len(parameters) - 2, 2):
        hidden = torch.relu(torch.nn.functional.linear(hidden, parameters[layer], parameters[layer + 1]))
    correction = torch.nn.functional.linear(hidden, parameters[-2], parameters[-1])
    return torch.from_numpy(near.plane_distance) + correction[:, 0]  # Eq. 5, as `decode`


def sdf_loss(predicted: Tensor, labels: Tensor, config: ImplicitMapConfig) -> Tensor:
    """Mean loss of predicted against labelled signed distances, both (m,) metres.

    `Loss` says which losses there are.
    """
    if config.loss is Loss.L1:
        return (predicted.clamp(-config.truncation, config.truncation) - labels).abs().mean()
    return torch.nn.functional.binary_cross_entropy_with_logits(
        predicted / config.loss_scale, torch.sigmoid(labels / config.loss_scale)
    )
