"""`python -m lab.relocalisation --among`: a map with places of other settings, far away."""

from __future__ import annotations

import numpy as np

from lab.relocalisation.recordings import ELSEWHERE_M, KnownPlace, Setting, among_others
from revisit.core.acceptance import Station
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from tests.support.places import a_place


def known(seed: int, count: int) -> list[KnownPlace]:
    vectors = np.random.default_rng(seed).normal(size=(count, 16)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return [
        KnownPlace(a_place(np.zeros((1, 2))), v, Station(0, n, se3.from_yaw(0.0, (10.0 * n, 0, 0))))
        for n, v in enumerate(vectors)
    ]


def test_others_lie_far_away_on_drives_of_their_own_and_the_map_stays() -> None:
    setting, others = Setting("map", PipelineConfig(), known(0, 3), []), known(1, 4)
    larger = among_others(setting, others, 600)
    assert larger.known[:3] == setting.known and len(larger.known) == 603
    added = larger.known[3:]
    assert [one.place for one in added[:5]] == [others[n % 4].place for n in range(5)]
    assert min(one.station.T_odom_submap[0, 3] for one in added) == ELSEWHERE_M
    places = {(one.station.drive, one.station.ordinal) for one in added}
    assert len(places) == 600 and all(drive != 0 for drive, _ in places)
    assert np.allclose([np.linalg.norm(one.vector) for one in added], 1.0, atol=1e-6)


def test_two_runs_put_the_same_places_there() -> None:
    setting, others = Setting("map", PipelineConfig(), known(0, 3), []), known(1, 4)
    first, second = (among_others(setting, others, 20).known for _ in range(2))
    assert all((one.vector == two.vector).all() for one, two in zip(first, second, strict=True))
