"""The chances with which the models of a stored neural map begin, learned in simulated towns (docs/decisions/0287)."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.training.corpus import training_drive
from lab.training.place_chances import keep
from revisit.core.codec.neural_chances import CHANCE_STEP, LEARNED, fresh_mixtures
from revisit.core.codec.neural_points import PlaneCodes, write_points
from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.implicit_map import fit_implicit_map
from revisit.core.implicit_map.settled import NORMAL_STEPS, OFFSET_UNIT, STORED_NORMAL_UNIT, plane_codes
from revisit.core.model_bundle import load_packaged_models
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.perturbations import Perturbation

SURE = 50
"""A chance begins as if it had been seen so often at most: the statistics of a map itself soon count more."""
WINDOW_SCANS, LONG_SCANS, STRIDE_SCANS, WINDOWS = 7, 14, 15, 3
_THIN = Perturbation(keep_beams=16, keep_points=0.06)
_FEW_BEAMS = Perturbation(keep_beams=16)


def main() -> None:
    """Fit maps of the training towns and write the learned models where there is no such file."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.map_chances", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("core/weights"), help="folder")
    parser.add_argument("--districts", type=int, default=12, help="simulated towns")
    options = parser.parse_args()
    maps = [codes for district in range(options.districts) for codes in training_maps(district)]
    order = np.random.default_rng(0).permutation(len(maps))
    keep(options.out / LEARNED, learned(maps[row] for row in order))


def training_maps(district: int) -> Iterator[PlaneCodes]:
    """Maps along a drive through training town `district`: dense, of 16 beams, and long thin ones, twice as many."""
    scans = list(islice(training_drive(district), (WINDOWS - 1) * STRIDE_SCANS + LONG_SCANS))
    for window in range(WINDOWS):
        part = scans[window * STRIDE_SCANS :][:LONG_SCANS]
        yield _codes_of(_thinned(part, _THIN), SubmapConfig(tau=20.0))
        if window % 2 == 0:
            yield _codes_of(part[:WINDOW_SCANS], SubmapConfig())
        if window == 0:
            yield _codes_of(_thinned(part[:WINDOW_SCANS], _FEW_BEAMS), SubmapConfig())


def _thinned(scans: list[Scan], perturbation: Perturbation) -> list[Scan]:
    return [
        Scan.validated(perturbation.thin(scan.points, index), scan.T_odom_sensor, scan.stamp_ns)
        for index, scan in enumerate(scans)
    ]


def _codes_of(scans: list[Scan], config: SubmapConfig) -> PlaneCodes:
    pipeline = PipelineConfig()
    submap, _ = Submap.from_window(scans, config).in_level_frame(pipeline.scene_scale)
    rng = np.random.default_rng(0)
    fitted = fit_implicit_map(submap, load_packaged_models().decoder, pipeline.implicit_map, rng)
    return plane_codes(fitted.points, fitted.config.resolution)


def learned(maps: Iterable[PlaneCodes]) -> dict[str, NDArray[np.integer]]:
    """The models after `maps`, as `core.codec.neural_chances` reads it."""
    mixtures = fresh_mixtures()
    for codes in maps:
        nothing = np.zeros((len(codes.voxels), 0), np.int32)
        write_points(codes, nothing, NORMAL_STEPS, OFFSET_UNIT, STORED_NORMAL_UNIT, mixtures)
    arrays: dict[str, NDArray[np.integer]] = {}
    for kind, mixture in zip(mixtures._fields, mixtures, strict=True):
        seen = np.minimum(mixture.models[:, 1], SURE).astype(np.uint8)
        arrays[f"{kind}_seen"] = seen
        arrays[f"{kind}_chances"] = (mixture.models[seen > 0, 0] // CHANCE_STEP).astype(np.uint8)
        arrays[f"{kind}_weights"] = mixture.weights.astype(np.int32)
    return arrays


if __name__ == "__main__":
    main()
