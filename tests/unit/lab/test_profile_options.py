"""Each option that the paper's text leaves open changes the descriptor of a submap, and is scored as the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as File

import numpy as np

from lab.domains.catalogue import DOMAINS, Domain, Pass, Setting
from lab.profile_options import OPTIONS, drives_by_option
from revisit.core.config import SubmapConfig
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.simulator import OS1_64, Path, build_city, drive, simulate


def street(folder: File) -> Domain:
    """A short simulated street, which is its own map: one submap."""
    way = Path.through([[0, 0], [11, 0]])
    world = build_city([Path.through([[-40, 4], [60, 4]])], seed=2, drive=way)
    scans = simulate(world, drive(way, world.ground, spacing_m=2.5), replace(OS1_64, columns=256), seed=0)
    write_kitti(folder, ((scan.points, scan.T_world_sensor, scan.stamp_ns) for scan in scans))
    submap = SubmapConfig(tau=10.0, stride=10.0)
    return replace(DOMAINS[0], make=lambda _: Pass(KittiRecording(folder)), submap=submap)


def test_every_option_describes_each_submap_and_none_as_the_form_that_is_written(tmp_path: File) -> None:
    drives = drives_by_option(street(tmp_path / "street"), Setting(tmp_path))
    assert list(drives) == list(OPTIONS)
    vectors = {}
    for option, found in drives.items():
        (submap,) = found.queries
        assert found.own_map and submap.description is not None
        vectors[option] = submap.description.vector
    written = vectors.pop("as written")
    assert np.isclose(np.linalg.norm(written), 1.0, atol=1e-5)
    assert {option: float(vector @ written) < 0.9999 for option, vector in vectors.items()} == dict.fromkeys(
        vectors, True
    )
