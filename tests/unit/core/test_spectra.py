"""The spectra depend neither on origin nor on heading, but on how faces and structure lie to each other."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.clusters import Clusters
from revisit.core.config import SpectrumConfig
from revisit.core.geometry import se3
from revisit.core.spectra import PlaceSpectra, describe_spectra
from revisit.core.spectra.profile import spectrum_size
from revisit.core.surface import Surface

CONFIG = SpectrumConfig()
AMPLITUDES = CONFIG.frequencies * (CONFIG.harmonics + 1)


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


def spectra(surface: Surface, labels: int = 0) -> PlaceSpectra:
    count = len(surface.vertices)
    clusters = Clusters(np.full(count, labels, dtype=np.int32), max(labels + 1, 0), np.zeros(count, dtype=bool))
    return describe_spectra(surface, clusters, CONFIG)


def change(one: Surface, other: Surface, of: str) -> float:
    before, after = getattr(spectra(one), of), getattr(spectra(other), of)
    return float(np.linalg.norm(before - after) / np.linalg.norm(before))


# Along each heading two or three walls; the headings of a street with one slanted house.
STREET = ([3.0, 9.0, 14.0, -6.0, 8.0, 2.0, 12.0], [0.0, 0.0, 0.0, 90.0, 90.0, 235.0, 235.0])
OTHER = ([3.0, 5.0, 19.0, -2.0, 14.0, 2.0, 5.0], STREET[1])


@pytest.mark.parametrize("of", ["normal", "plan"])
def test_a_turn_changes_little_and_another_arrangement_of_the_same_walls_much(of):
    one, other = faces(*STREET), change(faces(*STREET), faces(*OTHER), of)
    # 35 degrees are seven of the 72 headings over a turn, 18.3 lie between two of them.
    assert change(one, moved(one, se3.from_yaw(np.radians(35.0))), of) < 0.25 * other
    assert change(one, moved(one, se3.from_yaw(np.radians(18.3))), of) < 0.25 * other


@pytest.mark.parametrize("of", ["normal", "plan"])
def test_an_offset_of_two_metres_changes_less_than_another_arrangement(of):
    one = faces(*STREET)
    assert change(one, moved(one, se3.from_yaw(0.0, (1.6, -1.2, 0.0))), of) < 0.4 * change(one, faces(*OTHER), of)


@pytest.mark.parametrize("of", ["normal", "plan"])
def test_walls_in_step_answer_at_the_frequency_of_their_distance(of):
    # Eight walls across x, 8 m apart: 0.125 cycles/m.
    street = faces([-28.0, -20.0, -12.0, -4.0, 4.0, 12.0, 20.0, 28.0], [0.0] * 8)
    row = getattr(spectra(street), of)[:AMPLITUDES].reshape(CONFIG.harmonics + 1, CONFIG.frequencies)[0]
    frequency = np.linspace(1.0 / (2.0 * CONFIG.reach), CONFIG.highest, CONFIG.frequencies)
    assert frequency[5 + row[5:].argmax()] == pytest.approx(0.125, abs=0.011)


def test_which_way_walls_look_changes_the_normal_spectrum_and_not_the_plan():
    one = faces(*STREET)
    about = Surface(one.vertices, -one.normals, one.faces, one.occupied, one.occupancy, 0.4)
    some = Surface(
        one.vertices, np.where(np.arange(len(one.vertices))[:, None] < 100, -1, 1) * one.normals, one.faces,
        one.occupied, one.occupancy, 0.4,
    )  # fmt: skip
    assert change(one, some, "normal") > 0.2
    assert change(one, some, "plan") == 0.0
    assert change(one, about, "plan") == 0.0


def test_a_spectrum_has_the_size_it_says():
    # 24 frequencies x 13 amplitudes, and real and imaginary parts of 23 products of neighbours for 12 harmonics.
    assert spectrum_size(CONFIG) == 24 * 13 + 2 * 23 * 12 == len(spectra(faces(*STREET)).plan)


def test_what_belongs_to_no_cluster_does_not_count():
    nothing = spectra(faces(*STREET), labels=-1)
    assert not nothing.normal.any()
    assert not nothing.plan.any()
    assert len(nothing.normal) == len(nothing.plan) == spectrum_size(CONFIG)
