"""What an alignment is worth: hand-made surfaces with known overlap, contrast and contradictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification.evidence import contrast, gather_evidence, weakest_direction
from revisit.core.verification.oriented_points import OrientedPoints, contact, shared_shares
from revisit.core.verification.registration import Registration, information

CONFIG = VerificationConfig()
HERE = Registration(np.eye(4), refined=True)


def wall(along: np.ndarray, axis: int = 0, offset: float = 5.0) -> OrientedPoints:
    """An upright wall of 4 m at `offset`, running along x (axis 0) or y (axis 1)."""
    flat = np.zeros((len(along), 2))
    flat[:, axis], flat[:, 1 - axis] = along, offset
    points = np.concatenate([np.c_[flat, np.full(len(flat), z)] for z in np.arange(-1.5, 2.5, 0.5)])
    normals = np.tile(np.eye(3)[1 - axis] * -1.0, (len(points), 1))
    return OrientedPoints(points, normals, len(points))


def joined(*parts: OrientedPoints) -> OrientedPoints:
    """Several surfaces as one, all standing."""
    points = np.concatenate([part.points for part in parts])
    return OrientedPoints(points, np.concatenate([part.normals for part in parts]), len(points))


STREET = np.arange(-20.0, 20.0, 0.5) + 0.25
CORNER = joined(wall(STREET), wall(STREET, axis=1))


def test_a_place_lies_on_itself_without_residuals():
    evidence = gather_evidence(HERE, CORNER, CORNER, CONFIG)
    assert (evidence.overlap, evidence.rmse_m, evidence.seen_through) == (1.0, 0.0, 0.0)
    assert evidence.common == len(CORNER.points)
    np.testing.assert_allclose(evidence.information, information(CORNER.points, CORNER.normals))


def test_overlap_is_the_mean_of_both_directions_within_the_common_region():
    # Of the query's two walls the match has one; the columns of the other one are none of the match's.
    match, query = wall(STREET), joined(wall(STREET), wall(STREET, offset=9.0))
    assert gather_evidence(HERE, query, match, CONFIG).overlap == 1.0
    # A wall 0.9 m before the common one stands in the same columns, but not on the surface: half of the query agrees,
    # and all of the match.
    double = joined(wall(STREET, offset=4.1), wall(STREET, offset=5.0))
    assert gather_evidence(HERE, double, match, CONFIG).overlap == pytest.approx(0.75)


def test_rmse_is_that_of_the_distances_to_the_planes():
    shifted = Registration(se3.from_yaw(0.0, (0.0, 0.2, 0.0)), refined=True)
    assert gather_evidence(shifted, wall(STREET), wall(STREET), CONFIG).rmse_m == pytest.approx(0.2)
    apart = Registration(se3.from_yaw(0.0, (0.0, 90.0, 0.0)), refined=True)
    assert gather_evidence(apart, wall(STREET), wall(STREET), CONFIG).rmse_m == CONFIG.surface_distance


def test_what_stands_decides_and_the_ground_does_not():
    ground = replace(CORNER, points=CORNER.points + [0.0, 0.0, 30.0], standing_count=0)
    with_ground = OrientedPoints(
        np.r_[CORNER.points, ground.points], np.r_[CORNER.normals, ground.normals], CORNER.standing_count
    )
    evidence = gather_evidence(HERE, with_ground, CORNER, CONFIG)
    assert evidence.overlap == 1.0 and evidence.common == len(CORNER.points)


def test_a_street_loses_no_overlap_along_itself_unless_walls_cross_it():
    along = weakest_direction(information(wall(STREET).points, wall(STREET).normals))
    np.testing.assert_allclose(np.abs(along), [1.0, 0.0, 0.0], atol=1e-9)
    assert contrast(wall(STREET), wall(STREET), along, 1.0, CONFIG) == pytest.approx(0.0, abs=1e-9)
    crossing = joined(wall(STREET), *(wall(STREET, axis=1, offset=x) for x in np.arange(-20.0, 20.0, 1.7)))
    assert contrast(crossing, crossing, np.array([1.0, 0.0, 0.0]), 1.0, CONFIG) > 0.1


def test_a_wall_that_the_other_place_has_looked_through_counts_against_the_alignment():
    near, far = wall(np.arange(-3.0, 3.0, 0.5), offset=10.0), wall(np.arange(-15.0, 15.0, 0.5), offset=20.0)
    evidence = gather_evidence(HERE, joined(near, far), far, CONFIG)
    agreeing = gather_evidence(HERE, far, far, CONFIG)
    assert evidence.seen_through > 0.05 and agreeing.seen_through == 0.0


def test_an_alignment_that_was_given_up_has_the_worst_contrast_and_view():
    evidence = gather_evidence(Registration(np.eye(4), refined=False), CORNER, CORNER, CONFIG)
    assert (evidence.contrast, evidence.seen_through) == (0.0, 1.0)
    assert evidence.overlap == 1.0


def test_a_place_keeps_no_more_than_eight_slots_for_a_column_and_its_lowest_point():
    points = np.random.default_rng(5).uniform(-40, 40, (3000, 3))
    seen = OrientedPoints(points, points, 3000).seen
    lowest = {}
    for x, y, z in points:
        column = int(np.floor(x / 2.0)), int(np.floor(y / 2.0))
        lowest[column] = min(z, lowest.get(column, np.inf))
    entered = np.isfinite(seen.lowest)
    assert dict(zip(map(tuple, seen.slots[entered].tolist()), seen.lowest[entered], strict=True)) == lowest
    assert len(seen.slots) <= 8 * len(lowest)


def in_region(surface, other):
    """Which points (n,) of a surface stand in a column of two metres in which the other place has seen anything."""
    seen = {(int(x), int(y)) for x, y in np.floor(other.points[:, :2] / 2.0)}
    return np.array([(int(x), int(y)) in seen for x, y in np.floor(surface.points[:, :2] / 2.0)])


def test_the_compiled_shares_are_those_of_contact_in_the_common_region():
    rng = np.random.default_rng(4)
    surface = joined(wall(STREET), wall(STREET, axis=1, offset=-3.0))
    other = OrientedPoints(CORNER.points + rng.normal(0, 0.15, CORNER.points.shape), CORNER.normals, 900)
    offsets = np.array([[0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [2.5, 0.0, 0.0], [0.0, 60.0, 0.0]])
    expected = []
    for offset in offsets:
        moved = surface.shifted(offset)
        seen = in_region(moved, other)
        expected.append((contact(moved, other, CONFIG).touching & seen).sum() / max(seen.sum(), 1))
    assert 0.0 < expected[0] < 1.0 and expected[3] == 0.0
    np.testing.assert_allclose(shared_shares(surface, other, offsets, CONFIG), expected)


def test_contrast_is_against_the_move_that_loses_least_of_all():
    rng = np.random.default_rng(6)
    crossing = joined(wall(STREET), *(wall(STREET, axis=1, offset=x) for x in np.arange(-20.0, 20.0, 2.5)))
    points = crossing.points + rng.normal(0.0, 0.1, crossing.points.shape)
    surface, along = OrientedPoints(points, crossing.normals, len(points)), np.array([1.0, 0.0, 0.0])
    moves = np.outer([sign * shift for shift in CONFIG.contrast_shifts for sign in (-1.0, 1.0)], along)
    least_lost = max(shared_shares(surface, crossing, moves, CONFIG))
    assert 0.1 < least_lost < 1.0
    assert contrast(surface, crossing, along, 1.0, CONFIG) == 1.0 - least_lost
