"""The chances with which the models of a stored place begin, counted in simulated towns (docs/decisions/0287)."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.training.corpus import training_places
from revisit.core.codec import place_keypoints, place_surface
from revisit.core.codec.place import coded_form
from revisit.core.codec.place_surface import MODELS, coded, kinds, rounded
from revisit.core.config import PipelineConfig
from revisit.core.kernels.keypoint_models import KEYPOINT_MODELS
from revisit.core.kernels.range_coder import Models, fresh_models
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.place import Place

Counts = NDArray[np.float64]

SURE = 30
"""A chance begins as if it had been seen so often at most: the statistics of a place itself soon count more."""
_LEAST, _ALL = 64, 1 << 16


def main() -> None:
    """Describe places of the training towns and write the chances of surfaces and of keypoints where there are none."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.place_chances", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("core/weights"), help="folder")
    parser.add_argument("--districts", type=int, default=12, help="simulated towns")
    parser.add_argument("--places", type=int, default=4, help="places of each town, three views each")
    options = parser.parse_args()
    models, config = load_packaged_models(), PipelineConfig()
    described = [
        describe(view, models, config).place
        for district in range(options.districts)
        for views in training_places(district, config.submap, options.places)
        for view in views
    ]
    keep(options.out / place_surface.LEARNED, learned_chances(described, config.verification.spacing))
    keep(options.out / place_keypoints.LEARNED, learned_keypoint_chances(described))


def keep(file: Path, learned: Mapping[str, NDArray[np.integer]]) -> None:
    """Write the chances, unless the file is there: with others no stored place could be read."""
    if file.exists():
        print(f"{file} stays as it is")
        return
    arrays: dict[str, Any] = dict(learned)
    np.savez_compressed(file, **arrays)


def learned_chances(places: Iterable[Place], spacing: float) -> dict[str, NDArray[np.unsignedinteger]]:
    """Chance and how often it was seen, of each model and kind of surface, as `core.codec.place_surface` reads them."""
    ones = {kind: np.zeros(MODELS) for kind in kinds(spacing)}
    seen = {kind: np.zeros(MODELS) for kind in kinds(spacing)}
    for place in places:
        of_kind = {"standing": slice(place.standing_count), "ground": slice(place.standing_count, None)}
        for kind, (edge, steps) in kinds(spacing).items():
            points, normals = place.points[of_kind[kind]], place.normals[of_kind[kind]]
            if len(points):
                models = fresh_models(MODELS)
                coded(*rounded(points, normals, edge, steps), steps, models)
                ones[kind] += _ones(models)
                seen[kind] += models[:, 1]
    return {
        name: values
        for kind in kinds(spacing)
        for name, values in (
            (f"{kind}_chances", _chances(ones[kind], seen[kind])),
            (f"{kind}_seen", np.minimum(seen[kind], SURE).astype(np.uint8)),
        )
    }


def learned_keypoint_chances(places: Iterable[Place]) -> dict[str, NDArray[np.unsignedinteger]]:
    """Chance and how often it was seen, of each model of keypoints, as `core.codec.place_keypoints` reads them."""
    ones, seen = np.zeros(KEYPOINT_MODELS), np.zeros(KEYPOINT_MODELS)
    for place in places:
        if len(place.keypoints):
            models = fresh_models(KEYPOINT_MODELS)
            place_keypoints.coded_keypoints(*coded_form(place.keypoints, place.orientations, place.descriptors), models)
            ones += _ones(models)
            seen += models[:, 1]
    return {"chances": _chances(ones, seen), "seen": np.minimum(seen, SURE).astype(np.uint8)}


def _ones(models: Models) -> Counts:
    """How many ones each model (n, 2) has seen: a chance is (ones + 1/4) / (seen + 1/2), as `code_bit` moves it."""
    chances, seen = models.T
    return np.asarray(np.clip(chances / _ALL * (seen + 0.5) - 0.25, 0.0, seen))


def _chances(ones: Counts, seen: Counts) -> NDArray[np.uint16]:
    return np.clip((ones + 0.4) / (seen + 0.8) * _ALL, _LEAST, _ALL - _LEAST).astype(np.uint16)


if __name__ == "__main__":
    main()
