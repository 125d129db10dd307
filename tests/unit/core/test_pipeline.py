"""The whole narrative on small analytic scenes: a place is found again, another one is not."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from revisit.core.codec import neural_map as codec
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.core.descriptor.vlad import folded_size
from revisit.core.errors import DataLoss, DegenerateCloud, DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.implicit_map import NeuralMap
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import DescribedPlace, DescribedSurface, describe, describe_again, verify
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.evaluation.ablation import Ablation, describe_ablated

CONFIG = PipelineConfig()


def town(shapes, seed: int):
    """Boxes of random size along both sides of a street."""
    rng = np.random.default_rng(seed)
    blocks = [shapes["ground"]()]
    for side in (-1, 1):
        x = -45.0
        while x < 45:
            width, gap, depth = rng.uniform(4, 12), rng.uniform(1, 6), rng.uniform(3, 9)
            near = side * rng.uniform(5, 12)
            low, high = sorted((near, near + side * depth))
            blocks.append(shapes["box"]((x, low, 0), (x + width, high, rng.uniform(2.5, 8))))
            x += width + gap
    return blocks


@pytest.fixture
def seen_from(make_drive, shapes):
    """Describes town `seed` after the submap was turned by T_turned_submap, in an odometry frame that is turned by
    T_odom_level: (place, turned submap).
    """

    @cache
    def submap_of(seed: int) -> Submap:
        return make_drive(lambda _: town(shapes, seed), scans=5)

    def describe_turned(
        seed: int, T_turned_submap=None, T_odom_level=np.eye(4), **options
    ) -> tuple[DescribedSurface, Submap]:
        submap, turn = submap_of(seed), np.eye(4) if T_turned_submap is None else T_turned_submap
        turned = dataclasses.replace(
            submap,
            points=se3.apply(turn, submap.points).astype(np.float32),
            origins=se3.apply(turn, submap.origins).astype(np.float32),
            T_odom_submap=T_odom_level @ submap.T_odom_submap @ se3.inverse(turn),
        )
        return describe_ablated(turned, load_packaged_models(), CONFIG, **options), turned

    return describe_turned


def test_a_turned_and_tilted_place_is_recognised_and_aligned(seen_from):
    map_place, map_submap = seen_from(1)
    turn = se3.from_yaw(2.4) @ se3.exp([0, 0, 0, 0.1, -0.15, 0])
    query_place, query_submap = seen_from(1, turn)
    similarity = query_place.descriptor.similarity(map_place.descriptor)
    verdict = verify(query_place.place, map_place.place, similarity, CONFIG.verification)
    assert isinstance(verdict, VerifiedLoop)
    T_true = se3.inverse(map_submap.T_odom_submap) @ query_submap.T_odom_submap
    error = se3.inverse(verdict.measurement.T_match_query) @ T_true
    assert np.linalg.norm(error[:3, 3]) < 0.1
    assert np.degrees(se3.rotation_angle(error)) < 0.5


def test_two_sessions_whose_z_leans_are_levelled_by_their_own_ground(seen_from):
    """17 and 11 degrees, to different sides: without that no pair is a loop."""
    T_odoms = [np.eye(4), se3.exp([0, 0, 0, 0.28, 0.1, 0]), se3.exp([0, 0, 0, -0.1, -0.16, 0])]
    turns = [np.eye(4), se3.from_yaw(2.4) @ se3.exp([0, 0, 0, 0.03, -0.05, 0]), se3.from_yaw(-1.1)]
    seen = [seen_from(1, turn, T_odom_level=T_odom) for turn, T_odom in zip(turns, T_odoms, strict=True)]
    assert ["ground_tilted" in place.flags for place, _ in seen] == [False, True, True]
    for one, other in ((0, 1), (1, 2), (2, 0)):
        similarity = seen[one][0].descriptor.similarity(seen[other][0].descriptor)
        verdict = verify(seen[one][0].place, seen[other][0].place, similarity, CONFIG.verification)
        assert isinstance(verdict, VerifiedLoop)
        T_true = turns[other] @ se3.inverse(turns[one])
        error = se3.inverse(verdict.measurement.T_match_query) @ T_true
        assert np.linalg.norm(error[:3, 3]) < 0.1
        assert np.degrees(se3.rotation_angle(error)) < 0.5


def test_another_street_is_less_similar_and_rejected(seen_from):
    one, other, again = seen_from(1)[0], seen_from(2)[0], seen_from(1, se3.from_yaw(1.0))[0]
    assert one.descriptor.similarity(other.descriptor) < one.descriptor.similarity(again.descriptor)
    similarity = one.descriptor.similarity(other.descriptor)
    assert isinstance(verify(one.place, other.place, similarity, CONFIG.verification), RejectedLoop)


def test_the_same_submap_gives_the_same_bits(seen_from):
    first, second = seen_from(3)[0], seen_from(3)[0]
    assert first.descriptor.vector.tobytes() == second.descriptor.vector.tobytes()
    assert first.place.to_blob() == second.place.to_blob()
    assert first.neural_map.to_blob() == second.neural_map.to_blob()


@pytest.mark.parametrize("ablation", list(Ablation))
def test_every_ablation_still_gives_a_unit_descriptor(seen_from, ablation):
    place, _ = seen_from(1, ablation=ablation)
    assert np.linalg.norm(place.descriptor.vector) == pytest.approx(1.0, abs=1e-5)
    assert isinstance(place, DescribedPlace) == (ablation is not Ablation.NO_IMPLICIT)


def test_leaving_a_part_out_zeroes_its_share_of_the_descriptor(seen_from):
    books, sizes = load_packaged_models().codebooks, CONFIG.fusion
    assert (folded_size(books.macro_folds), folded_size(books.micro_folds)) == (sizes.macro_size, sizes.micro_size)
    bases = books.spectrum_basis, books.layout_basis, books.plan_basis
    assert tuple(len(basis) for basis in bases) == (sizes.spectrum_size, sizes.layout_size, sizes.plan_size)
    ends = np.cumsum([sizes.macro_size, sizes.micro_size + sizes.spectrum_size])

    def parts_of(ablation: Ablation) -> list[bool]:
        return [bool(part.any()) for part in np.split(seen_from(1, ablation=ablation)[0].descriptor.vector, ends)]

    assert parts_of(Ablation.NONE) == [True, True, True]
    assert parts_of(Ablation.BEV_ONLY) == [True, False, True]
    assert parts_of(Ablation.NORMALS_ONLY) == [False, True, False]


def test_leaving_parts_out_afterwards_is_the_same_as_describing_without_them(seen_from):
    whole, faces, image = (
        seen_from(1, ablation=ablation)[0].descriptor.vector
        for ablation in (Ablation.NONE, Ablation.NORMALS_ONLY, Ablation.BEV_ONLY)
    )
    np.testing.assert_allclose(without_parts(whole, CONFIG.fusion, bev=True), faces, atol=1e-6)
    np.testing.assert_allclose(without_parts(whole, CONFIG.fusion, normals=True), image, atol=1e-6)


def test_a_floor_without_walls_is_flagged_and_never_a_loop(make_drive, shapes):
    floor = make_drive(lambda _: [shapes["ground"]()], scans=3)
    described = describe(floor, load_packaged_models(), CONFIG)
    assert described.flags == ("degenerate_plane",)
    assert isinstance(verify(described.place, described.place, 1.0, CONFIG.verification), RejectedLoop)


def test_a_place_whose_ground_is_no_ground_in_the_odometry_s_frame_is_flagged(make_drive, shapes):
    floor = make_drive(lambda _: [shapes["ground"]()], scans=3)
    T_camera_lidar = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    assert "ground_tilted" not in describe(floor, load_packaged_models(), CONFIG).flags
    in_camera_axes = replace(floor, T_odom_submap=T_camera_lidar @ floor.T_odom_submap)
    assert "ground_tilted" in describe(in_camera_axes, load_packaged_models(), CONFIG).flags


def test_walls_beyond_the_birds_eye_view_are_refused_instead_of_described_by_zeros():
    # Two walls 72 m to either side: the image covers 50 m, so that every part of the descriptor would be zero.
    side, along, height = np.meshgrid([-72.0, 72.0], np.linspace(-20, 20, 100), np.linspace(-2, 6, 30))
    walls = np.stack([side.ravel(), along.ravel(), height.ravel()], axis=1)
    submap = Submap.from_scans([Scan.validated(walls, np.eye(4), 0)], CONFIG.submap)
    with pytest.raises(DegenerateCloud, match="bird's-eye view"):
        describe(submap, load_packaged_models(), CONFIG)


def test_the_neural_map_knows_the_frame_of_its_submap(seen_from):
    turn = se3.exp([0, 0, 0, 0.2, 0, 0])
    described, submap = seen_from(1, turn)
    in_map = described.neural_map.frame.points_to_level(submap.points[::50])
    assert np.median(np.abs(described.neural_map.sdf(in_map.astype(np.float32))[0])) < 0.03


def test_a_place_described_again_from_its_stored_map_is_the_place_it_was(seen_from):
    described, _ = seen_from(1)
    models = load_packaged_models()
    stored = NeuralMap.from_blob(described.neural_map.to_blob(), models.decoder, CONFIG.implicit_map)
    again = describe_again(stored, models, CONFIG)
    other, _ = seen_from(2)
    likeness = described.descriptor.similarity(again.descriptor)
    assert likeness > 0.95
    assert likeness > described.descriptor.similarity(other.descriptor) + 0.1
    verdict = verify(again.place, described.place, likeness, CONFIG.verification)
    assert isinstance(verdict, VerifiedLoop)
    assert np.allclose(verdict.measurement.T_match_query, np.eye(4), atol=0.03)


def test_a_stored_neural_map_whose_frame_is_no_similarity_is_refused(seen_from):
    field = seen_from(1)[0].neural_map
    header, sections = codec.unpack(field.to_blob())
    decoder = load_packaged_models().decoder
    stored = NeuralMap.from_blob(field.to_blob(), decoder, field.config).frame
    assert np.array_equal(stored.similarity, field.frame.similarity)
    for numbers in (np.zeros(16), np.diag([1.0, 2.0, 1.0, 1.0]), np.ones(1)):
        sections[0] = codec.pack_moments(numbers, field.stamps_ns)
        with pytest.raises(DataLoss, match="level frame"):
            NeuralMap.from_blob(codec.pack(header, sections), decoder, field.config)


def test_a_room_described_at_its_scale_is_aligned_in_metres(seen_from):
    _, submap = seen_from(1)
    small = dataclasses.replace(submap, points=submap.points * 0.25, origins=submap.origins * 0.25)
    turn = se3.from_yaw(1.2, (0.3, -0.2, 0.0)) @ se3.exp([0, 0, 0, 0.35, 0, 0])
    turned = dataclasses.replace(
        small,
        points=se3.apply(turn, small.points).astype(np.float32),
        origins=se3.apply(turn, small.origins).astype(np.float32),
        T_odom_submap=small.T_odom_submap @ se3.inverse(turn),
    )
    rooms = dataclasses.replace(CONFIG, scene_scale=0.25)
    match, query = (describe(one, load_packaged_models(), rooms) for one in (small, turned))
    verdict = verify(query.place, match.place, 1.0, CONFIG.verification)
    assert isinstance(verdict, VerifiedLoop)
    error = verdict.measurement.T_match_query @ turn
    assert np.linalg.norm(error[:3, 3]) < 0.04
    assert np.degrees(se3.rotation_angle(error)) < 0.6
    assert np.linalg.det(verdict.measurement.T_match_query[:3, :3]) == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(DescriptorModelMismatch):
        verify(query.place, seen_from(1)[0].place, 1.0, CONFIG.verification)
