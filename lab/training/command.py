"""The training command: shipped decoder and codebooks from simulated towns, with a report."""

from __future__ import annotations

import argparse
import io
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from lab.training.codebooks import Features, train_codebooks
from lab.training.corpus import TRAINING_SEED, training_places
from lab.training.decoder import initial_decoder, train_decoder, training_set
from revisit.core.bev import describe_bev
from revisit.core.clusters import segment_clusters
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.vlad import Codebooks
from revisit.core.implicit_map import DecoderWeights, fit_implicit_map
from revisit.core.micro.cluster_normals import describe_clusters
from revisit.core.micro.saliency import weigh_clusters
from revisit.core.model_bundle import TRAINED_WITH, load_bundle, training_record
from revisit.core.profiles import Profile, profile_config
from revisit.core.spectra import describe_spectra
from revisit.core.submap import Submap
from revisit.core.surface import extract_surface

DECODER_PLACES_EACH = 4
DECODER_WIDTH = 32


def main() -> None:
    """Train the chosen models and write the weights and the report."""
    parser = argparse.ArgumentParser(prog="python -m lab.training", description=__doc__)
    parser.add_argument("--profile", type=Profile, default=Profile.PRODUCT, help="product or paper")
    parser.add_argument("--out", type=Path, default=Path("core/weights/revisit-1.npz"))
    parser.add_argument("--decoder", type=Path, help="keep the decoder of this file and train the codebooks only")
    parser.add_argument("--report", type=Path, default=Path("docs/reference/training.md"))
    parser.add_argument("--districts", type=int, default=24, help="simulated towns for the codebooks")
    parser.add_argument("--places", type=int, default=14, help="places of each town for the codebooks")
    parser.add_argument("--episodes", type=int, default=600, help="meta-training episodes of the decoder")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    torch.set_num_threads(1)
    started, config = time.monotonic(), profile_config(options.profile)
    report = [
        "# Training of the shipped models",
        "",
        "By `python -m lab.training`, on simulated data only.",
        "",
    ]
    if options.decoder:
        decoder = _kept_decoder(options.decoder)
        report.append("- decoder: kept")
    else:
        decoder, losses = _train_decoder(config, options.episodes)
        report.append(f"- decoder: {options.episodes} episodes, loss {losses[0]:.3f} -> {np.mean(losses[-50:]):.3f}")
    books, count = _train_codebooks(config, decoder, options.districts, options.places, options.jobs)
    report.append(f"- codebooks: {count} places of {options.districts} towns, three views each")
    content = _pack(decoder, books, config)
    options.out.write_bytes(content)
    report.append(f"- seeds from {TRAINING_SEED}, used for nothing else")
    report.append(f"- model version: {load_bundle(content).version}, {len(content) / 1e6:.2f} MB")
    report.append(f"- {time.monotonic() - started:.0f} s on {options.jobs} processes")
    options.report.write_text("\n".join(report) + "\n")


def _train_decoder(config: PipelineConfig, episodes: int) -> tuple[DecoderWeights, list[float]]:
    rng = np.random.default_rng(0)
    sets = [
        training_set(submap, config.implicit_map, rng)
        for district in range(12)
        for views in training_places(district, config.submap, DECODER_PLACES_EACH)
        for submap in views[:2]
    ]
    start = initial_decoder(config.implicit_map, DECODER_WIDTH, hidden_layers=1, seed=0)
    return train_decoder(sets, start, config.implicit_map, episodes, seed=0)


def _kept_decoder(weights: Path) -> DecoderWeights:
    with np.load(weights, allow_pickle=False) as archive:
        return DecoderWeights.from_arrays({name: archive[name] for name in archive.files if "decoder" in name})


def _train_codebooks(
    config: PipelineConfig, decoder: DecoderWeights, districts: int, places: int, jobs: int
) -> tuple[Codebooks, int]:
    work = partial(district_features, config=config, decoder=decoder, count=places)
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        features = [place for district in pool.map(work, range(districts)) for place in district]
    return train_codebooks(features, config.bev.cells, config.fusion, seed=0), len(features)


def district_features(
    district: int, config: PipelineConfig, decoder: DecoderWeights, count: int
) -> list[list[Features]]:
    """The features of every view of the first `count` places of a training town."""
    torch.set_num_threads(1)
    rng = np.random.default_rng([TRAINING_SEED, district])
    places = training_places(district, config.submap, count)
    return [[view_features(view, config, decoder, rng) for view in views] for views in places]


def view_features(
    submap: Submap, config: PipelineConfig, decoder: DecoderWeights, rng: np.random.Generator
) -> Features:
    """The part of `core.pipeline.describe` before codebooks, of a levelled submap."""
    field = fit_implicit_map(submap, decoder, config.implicit_map, rng)
    surface = extract_surface(field, config.surface)
    clusters = segment_clusters(surface, config.clusters)
    bev = describe_bev(surface, clusters, config.bev)
    saliency = weigh_clusters(bev.keypoints, surface, clusters, config.micro.epsilon)
    micro = describe_clusters(surface, clusters, bev.keypoints, saliency, config.micro, rng)
    return Features(bev.descriptors, micro, bev.layout, describe_spectra(surface, clusters, config.spectra))


def _pack(decoder: DecoderWeights, books: Codebooks, config: PipelineConfig) -> bytes:
    buffer = io.BytesIO()
    arrays: dict[str, NDArray[Any]] = {**decoder.to_arrays(), **books.to_arrays()}
    arrays[TRAINED_WITH] = training_record(config)
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
