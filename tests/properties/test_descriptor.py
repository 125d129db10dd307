"""The descriptor of a place does not depend on the heading or on small displacements of its frame."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from revisit.core.descriptor.fusion import PlaceDescriptor
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry import se3
from tests.support.yards import moved, recognised, yard


@cache
def descriptor_of(seed: int) -> PlaceDescriptor:
    """That of a yard as it stands."""
    return recognised(yard(seed, 40))[0]


@pytest.mark.parametrize("yaw_deg", [30.0, 90.0, 137.0, 180.0])
def test_a_turned_place_is_more_like_itself_than_like_any_other(yaw_deg: float) -> None:
    place = descriptor_of(1)
    turned = recognised(moved(yard(1, 40), se3.from_yaw(np.radians(yaw_deg))))[0]
    others = [place.similarity(descriptor_of(seed)) for seed in (2, 3, 4)]
    assert place.similarity(turned) > max(others)


def test_a_displaced_place_is_more_like_itself_than_like_any_other() -> None:
    place = recognised(yard(1, 40))[0]
    shifted = recognised(moved(yard(1, 40), se3.from_yaw(0.0, (2.9, -1.7, 0.0))))[0]
    assert place.similarity(shifted) > place.similarity(recognised(yard(2, 40))[0]) + 0.2


def test_a_quarter_turn_changes_the_descriptor_by_pixel_rounding_only() -> None:
    place = recognised(yard(1, 40))[0]
    turned = recognised(moved(yard(1, 40), se3.from_yaw(np.pi / 2)))[0]
    assert place.similarity(turned) > 0.85


def test_descriptors_are_unit_vectors_of_at_most_1024_numbers() -> None:
    vector = recognised(yard(1, 40))[0].vector
    assert vector.dtype == np.float32
    assert vector.ndim == 1
    assert len(vector) <= 1024
    assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-5)


def test_descriptors_of_different_models_are_never_compared() -> None:
    vector = np.ones(1, np.float32)
    with pytest.raises(DescriptorModelMismatch):
        PlaceDescriptor(vector, "a").similarity(PlaceDescriptor(vector, "b"))
