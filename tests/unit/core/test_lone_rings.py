"""Ground that one beam hit: its rings stand around each spot a scan was taken from and must not be aligned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe, verify
from revisit.core.place import Place
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.verification import VerifiedLoop
from revisit.core.verification.oriented_points import OrientedPoints
from tests.support.block_worlds import STEP_M, along, corridors, seen

CONFIG = PipelineConfig()


def place_from(start_m: float, seed: int) -> tuple[Place, np.ndarray]:
    """What a drive of 10 m along a corridor with posts sees, and its pose in the world."""
    poses = along((start_m, 0.0), (start_m + 8 * STEP_M + 0.1, 0.0))
    scans = [Scan.validated(*scan, stamp) for stamp, scan in enumerate(seen(corridors(4), poses, seed))]
    submap = Submap.from_scans(scans, CONFIG.submap)
    return describe(submap, load_packaged_models(), CONFIG).place, submap.T_odom_submap


@pytest.fixture(scope="module")
def corridor():
    """Two drives whose scans were taken 0.46 m apart, but for whole steps."""
    return place_from(12.5, 1), place_from(12.5 + 2 * STEP_M + 0.46, 2)


def test_drives_along_a_corridor_are_aligned_by_its_walls_and_not_by_where_scans_were_taken(corridor) -> None:
    (match, T_world_match), (query, T_world_query) = corridor
    fits_once = replace(CONFIG.verification, rival_repeats_share=2.0)  # from either end it is nearly the same corridor
    verdict = verify(query, match, 1.0, fits_once)
    assert isinstance(verdict, VerifiedLoop)
    error = se3.log(se3.inverse(T_world_match) @ T_world_query @ se3.inverse(verdict.measurement.T_match_query))
    assert np.linalg.norm(error[:3]) < 0.2
    assert error @ np.linalg.solve(verdict.measurement.covariance, error) < 12.6


def test_ground_whose_normal_is_steep_looks_up_and_all_else_stays_as_it_was(corridor) -> None:
    place = corridor[0][0]
    surface, standing = OrientedPoints.of(place), place.standing_count
    stored, upright = place.normals.astype(np.float64), np.array([0.0, 0.0, 1.0])
    steep = np.abs(stored[standing:, 2]) < np.cos(np.radians(70.0))
    assert 0.2 < steep.mean() < 0.8  # rings beyond the ends of the corridor, and the floor in it
    assert (surface.normals[standing:][steep] == upright).all()
    assert (surface.normals[standing:][~steep] == stored[standing:][~steep]).all()
    assert (surface.normals[:standing] == stored[:standing]).all()
    assert (surface.points == place.points).all()
