"""Options that the paper's text leaves open: the paper's form with one of them changed.

`python -m lab.profile_options OUT DOMAIN [DOMAIN ...]` prints a row for each option, in the units of
`profile_tables`. The surface of a submap is fitted once for all options of its description.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lab.command_line import run
from lab.domains.catalogue import DOMAINS, Domain, Setting
from lab.profile_tables import SHARE, Drives, judged
from revisit.core.config import Evaluation, Fitting, ImplicitMapConfig, KeypointSource, PipelineConfig, SurfaceConfig
from revisit.core.errors import RevisitError
from revisit.core.implicit_map import DecoderWeights, fit_implicit_map
from revisit.core.pipeline import describe_surface
from revisit.core.profiles import Profile, profile_config, profile_models
from revisit.core.submap import Submap
from revisit.core.surface import Surface, extract_surface
from revisit.evaluation.cutting import Window, cut, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.loop_closure_method import Description
from revisit.evaluation.perturbations import Perturbation, turned

Option = Callable[[PipelineConfig], PipelineConfig]

OPTIONS: dict[str, Option] = {
    "as written": lambda config: config,
    "fitted at once": lambda c: replace(c, implicit_map=replace(c.implicit_map, fitting=Fitting.AT_ONCE)),
    "FAST on the image": lambda c: replace(c, bev=replace(c.bev, keypoint_source=KeypointSource.IMAGE)),
    "saliency after the VLAD": lambda c: replace(c, fusion=replace(c.fusion, literal_saliency=False)),
    "psi around keypoints": lambda c: replace(c, micro=replace(c.micro, evaluation=Evaluation.KEYPOINT)),
    "clusters grown half as far": lambda c: replace(c, clusters=replace(c.clusters, radius=c.clusters.radius / 2)),
    "clusters grown twice as far": lambda c: replace(c, clusters=replace(c.clusters, radius=c.clusters.radius * 2)),
}


def drives_by_option(domain: Domain, setting: Setting, options: dict[str, Option] = OPTIONS) -> dict[str, Drives]:
    """The described submaps of a domain with each of the options."""
    made, config = domain.make(setting), profile_config(Profile.PAPER, PipelineConfig(submap=domain.submap))
    queries = list(_described(made.queries, made.thinned_queries, config, options))
    mapped = queries if made.mapped is None else list(_described(made.mapped, made.thinned_map, config, options))
    found = {}
    for name in options:
        asking = [one[name] for one in queries]
        found[name] = Drives(asking, asking if made.mapped is None else [one[name] for one in mapped])
    return found


def _described(
    recording: Recording, perturbation: Perturbation, config: PipelineConfig, options: dict[str, Option]
) -> Iterator[dict[str, DescribedSubmap]]:
    """Each submap that can be described, with each option."""
    models = profile_models(Profile.PAPER)
    for index, window in enumerate(cut(recording, config.submap)):
        yaw = perturbation.yaw(index)
        try:
            submap = turned(load_submap(recording, window, config.submap, perturbation)[0], yaw)
            level, frame = submap.in_level_frame(config.scene_scale)
            surface_by = cache(partial(_surface, level, models.decoder))
            vectors = {
                name: describe_surface(
                    surface_by(option(config).implicit_map, config.surface), frame, models, option(config),
                    np.random.default_rng(0),
                )
                for name, option in options.items()
            }  # fmt: skip
        except RevisitError:
            continue
        yield {
            name: _stored(index, window, recording, yaw, described.descriptor.vector)
            for name, described in vectors.items()
        }


def _surface(level: Submap, decoder: DecoderWeights, field: ImplicitMapConfig, config: SurfaceConfig) -> Surface:
    return extract_surface(fit_implicit_map(level, decoder, field, np.random.default_rng(0)), config)


def _stored(
    index: int, window: Window, recording: Recording, yaw: float, vector: NDArray[np.float32]
) -> DescribedSubmap:
    poses = [recording.pose(scan) for scan in window]
    position = np.mean([pose[:3, 3] for pose in poses], axis=0)
    return DescribedSubmap(
        index, window, position, poses[len(poses) // 2], yaw, Description(vector, b""), None, points=0
    )


def main(out: Path, names: list[str]) -> None:
    """Print a row for each option and domain."""
    torch.set_num_threads(1)
    print("| domain | option | cosine: AUC, F1, recall@1 | standardised: AUC, F1, recall@1 |\n|---|---|---|---|")
    for domain in DOMAINS:
        if domain.name in names and not domain.missing:
            for option, drives in drives_by_option(domain, Setting(out, SHARE)).items():
                both = [judged(drives, domain, standardised=standardised) for standardised in (False, True)]
                cells = [
                    f"{one.recognition.auc.value:.3f}, {one.recognition.max_f1.value:.3f}, {one.recall_at_1:.3f}"
                    for one in both
                ]
                print(f"| {domain.name} | {option} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    run(main)
