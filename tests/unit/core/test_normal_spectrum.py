"""The normal spectrum depends neither on origin nor on heading, but on how the faces lie to each other."""

from __future__ import annotations

import numpy as np
import pytest

from core import se3
from core.clusters import Clusters
from core.config import MicroConfig
from core.normal_spectrum import normal_spectrum
from core.surface import Surface

CONFIG = MicroConfig()


def faces(places_m: list[float], headings_deg: list[float], breadth_m: float = 10.0) -> Surface:
    """Walls whose middle lies `place` m along `heading` and which look that way, a vertex every 0.2 m of breadth."""
    across = np.arange(-breadth_m / 2, breadth_m / 2, 0.2)
    vertices, normals = [], []
    for place, heading in zip(places_m, np.radians(headings_deg), strict=True):
        ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
        vertices.append(place * ahead + across[:, None] * [-ahead[1], ahead[0], 0.0])
        normals.append(np.tile(ahead, (len(across), 1)))
    vertices, normals = np.concatenate(vertices).astype(np.float32), np.concatenate(normals).astype(np.float32)
    nothing = np.zeros((0, 3), dtype=np.int32)
    return Surface(vertices, normals, nothing, nothing, np.zeros(0, dtype=np.float32), 0.4)


def moved(surface: Surface, T: np.ndarray) -> Surface:
    vertices, normals = se3.apply(T, surface.vertices), surface.normals @ T[:3, :3].T
    return Surface(
        vertices.astype(np.float32), normals.astype(np.float32), surface.faces, surface.occupied, surface.occupancy, 0.4
    )


def spectrum(surface: Surface, labels: int = 0) -> np.ndarray:
    count = len(surface.vertices)
    clusters = Clusters(np.full(count, labels, dtype=np.int32), max(labels + 1, 0), np.zeros(count, dtype=bool))
    found = normal_spectrum(surface, clusters, CONFIG)
    return found.reshape(CONFIG.spectrum_frequencies, CONFIG.spectrum_harmonics + 1)


def change(one: Surface, other: Surface) -> float:
    before, after = spectrum(one), spectrum(other)
    return float(np.linalg.norm(before - after) / np.linalg.norm(before))


# Along each heading two or three walls; the headings of a street with one slanted house.
STREET = ([3.0, 9.0, 14.0, -6.0, 8.0, 2.0, 12.0], [0.0, 0.0, 0.0, 90.0, 90.0, 235.0, 235.0])
OTHER = ([3.0, 5.0, 19.0, -2.0, 14.0, 2.0, 5.0], STREET[1])


def test_a_turn_changes_little_and_another_arrangement_of_the_same_walls_much():
    one, other = faces(*STREET), change(faces(*STREET), faces(*OTHER))
    # 35 degrees are seven of the 72 headings, 18.3 lie between two of them.
    assert change(one, moved(one, se3.from_yaw(np.radians(35.0)))) < 0.2 * other
    assert change(one, moved(one, se3.from_yaw(np.radians(18.3)))) < 0.2 * other


def test_an_offset_of_two_metres_changes_less_than_another_arrangement():
    one = faces(*STREET)
    assert change(one, moved(one, se3.from_yaw(0.0, (1.6, -1.2, 0.0)))) < 0.4 * change(one, faces(*OTHER))


def test_walls_in_step_answer_at_the_frequency_of_their_distance() -> None:
    # Eight walls that look along x, 8 m apart: 0.125 cycles/m, which is entry 10 of 20 between 0.01 and 0.25.
    row = spectrum(faces([-28.0, -20.0, -12.0, -4.0, 4.0, 12.0, 20.0, 28.0], [0.0] * 8))[:, 0]
    frequency = np.linspace(0.01, 0.25, 20)
    assert frequency[5 + row[5:].argmax()] == pytest.approx(0.125, abs=0.013)


def test_what_belongs_to_no_cluster_does_not_count() -> None:
    assert not spectrum(faces(*STREET), labels=-1).any()
