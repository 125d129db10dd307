"""Neural points as a stream of bits (docs/decisions/0287)."""

from __future__ import annotations

import dataclasses
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from revisit.core.codec import known_points
from revisit.core.codec.known_points import KnownPoints
from revisit.core.codec.neural_points import Form, PlaneCodes, read_points, write_points, written_points
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.kernels import mixed_coder
from revisit.core.kernels.range_coder import code_number, finish, fresh_models, start

CRC_OF_TABLES = 0x1179398D


def random_codes(rng: np.random.Generator, count: int, reach: int) -> PlaneCodes:
    voxels = np.unique(rng.integers(-reach, reach, (count, 3)), axis=0).astype(np.int32)
    rng.shuffle(voxels)
    planes = np.column_stack([rng.integers(0, 31, (len(voxels), 2)), rng.integers(-20, 21, len(voxels)),
                              rng.integers(0, 4, len(voxels))])  # fmt: skip
    return PlaneCodes(voxels, planes.astype(np.int32))


def street(reach: int = 60) -> PlaneCodes:
    """A floor and a wall of voxels with noisy planes, as drives see them."""
    rng = np.random.default_rng(2)
    side = np.stack(np.meshgrid(np.arange(-reach, reach), np.arange(-reach, reach)), axis=-1).reshape(-1, 2)
    floor = np.column_stack([side, np.zeros(len(side))])
    wall = np.column_stack([np.full(len(side), reach), side[:, 0], 1 + np.abs(side[:, 1]) // 2])
    voxels = np.unique(np.concatenate([floor, wall]).astype(np.int32), axis=0)
    normal = np.where((voxels[:, 2] == 0)[:, None], (15, 15), (0, 15)) + rng.integers(0, 2, (len(voxels), 2))
    planes = np.column_stack([normal, rng.integers(-1, 2, len(voxels)), np.full(len(voxels), 2)])
    return PlaneCodes(voxels, planes.astype(np.int32))


def in_order(codes: PlaneCodes, features: np.ndarray) -> np.ndarray:
    rows = np.column_stack([codes.voxels, codes.planes, features])
    return rows[np.lexsort(codes.voxels.T)]


@pytest.mark.parametrize(("count", "reach", "features"), [(1, 5, 0), (40, 3, 0), (3000, 40, 8), (500, 2**19, 3)])
def test_what_is_written_is_read_whatever_it_is(count, reach, features):
    rng = np.random.default_rng(count)
    codes = random_codes(rng, count, reach)
    values = rng.integers(-127, 128, (len(codes.voxels), features)).astype(np.int32)
    form, stream = write_points(codes, values, 15, 48)
    read, found = read_points(form, stream)
    assert np.array_equal(in_order(read, found), in_order(codes, values))


@pytest.mark.parametrize("written", [True, False])
def test_known_points_are_those_that_reading_gives(monkeypatch, written):
    """Whether they were written or read before; in the same order."""
    known = KnownPoints(most_bytes=2**20)
    for codes in (street(), random_codes(np.random.default_rng(6), 2000, 9), street(0)):
        form, stream, read = written_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48, 2)
        fresh = read_points(form, stream)
        if written:
            known.keep(form, stream, read)
        else:
            known.read(form, stream)
        with monkeypatch.context() as patched:
            patched.setattr(known_points, "read_points", None)
            again = known.read(form, stream)
        for one, other in (
            (fresh[0].voxels, again[0].voxels),
            (fresh[0].planes, again[0].planes),
            (fresh[1], again[1]),
        ):
            assert one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def test_known_points_are_bounded_in_bytes_and_none_are_kept_that_do_not_fit_their_form(monkeypatch):
    asked, read = [], read_points
    monkeypatch.setattr(known_points, "read_points", lambda form, stream: asked.append(1) or read(form, stream))
    rng = np.random.default_rng(1)
    some = [random_codes(rng, 2000, 9) for _ in range(4)]
    forms = [write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48) for codes in some]
    one = KnownPoints(most_bytes=2**20)
    one.read(*forms[0])
    known = KnownPoints(most_bytes=int(2.5 * one.held_bytes))
    for number, reads in ((0, 2), (1, 3), (0, 3), (2, 4), (0, 4), (1, 5)):
        known.read(*forms[number])
        assert len(asked) == reads and 0 < known.held_bytes <= 2.5 * one.held_bytes
    far = random_codes(rng, 40, 2**18)
    features = np.ones((len(some[0].voxels), 1), np.int32)
    none = np.zeros((len(far.voxels), 0), np.int32)
    for form, stream in (write_points(far, none, 15, 48), write_points(some[0], features, 15, 48)):
        before = known.held_bytes
        for _ in range(2):
            assert len(known.read(form, stream)[0].voxels) == form.count
        assert known.held_bytes == before


def test_known_points_may_be_asked_by_any_thread():
    rng = np.random.default_rng(3)
    some = [random_codes(rng, 60, 9) for _ in range(4)]
    forms = [write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48) for codes in some]
    known = KnownPoints(most_bytes=2**20)
    known.read(*forms[0])
    known = KnownPoints(most_bytes=2 * known.held_bytes + 20)
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            read = list(pool.map(lambda number: len(known.read(*forms[number % 4])[0].voxels), range(600)))
    finally:
        sys.setswitchinterval(before_s)
    assert read == [forms[number % 4][0].count for number in range(600)]
    assert known.held_bytes == sum(map(len, known._packed.values()))


def test_normals_beside_others_are_rounded_to_two_steps_and_planes_keep_their_foot():
    codes = random_codes(np.random.default_rng(6), 2000, 9)
    nothing = np.zeros((len(codes.voxels), 0), np.int32)
    form, stream = write_points(codes, nothing, 15, 48, 2)
    read, _ = read_points(form, stream)
    before, after = in_order(codes, nothing), in_order(read, nothing)
    assert np.array_equal(before[:, [0, 1, 2, 6]], after[:, [0, 1, 2, 6]])
    apart = np.abs(before[:, None, :3] - before[None, :, :3]).max(axis=2)
    beside = np.sort(apart, axis=1)[:, 1] == 1
    assert beside.mean() > 0.9 and np.abs(after[beside, 3:5] - before[beside, 3:5]).max() == 1
    alike = np.einsum("ij,ij->i", octahedral.decode(before[:, 3:5], 15), octahedral.decode(after[:, 3:5], 15))
    assert np.abs(after[:, 5] - alike * before[:, 5]).max() < 0.51
    assert write_points(read, nothing, 15, 48, 2) == (form, stream)
    assert len(stream) < len(write_points(codes, nothing, 15, 48)[1])


def test_the_tables_of_the_mixture_are_the_same_on_every_machine():
    tables = mixed_coder._STRETCH.astype("<i8").tobytes() + mixed_coder._SQUASH.astype("<i8").tobytes()
    assert zlib.crc32(tables) == CRC_OF_TABLES, "what other machines have written could not be read"


def test_of_two_points_in_one_voxel_the_first_is_written():
    voxels = np.array([[3, 1, 2], [0, 0, 0], [3, 1, 2]], np.int32)
    planes = np.array([[1, 2, 3, 0], [4, 5, 6, 1], [7, 8, 9, 2]], np.int32)
    form, stream = write_points(PlaneCodes(voxels, planes), np.zeros((3, 0), np.int32), 15, 48)
    read, _ = read_points(form, stream)
    assert form.count == 2
    assert sorted(map(tuple, read.planes.tolist())) == [(1, 2, 3, 0), (4, 5, 6, 1)]


def test_nothing_is_written_as_nothing():
    form, stream = write_points(PlaneCodes(np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int32)),
                                np.zeros((0, 0), np.int32), 15, 48)  # fmt: skip
    assert stream == b"" and len(read_points(form, stream)[0].voxels) == 0


def test_the_order_of_the_points_changes_no_bit():
    codes = street(20)
    shuffled = codes[np.random.default_rng(4).permutation(len(codes.voxels))]
    nothing = np.zeros((len(codes.voxels), 0), np.int32)
    assert write_points(codes, nothing, 15, 48) == write_points(shuffled, nothing, 15, 48)


def test_a_street_takes_less_than_six_bits_a_point():
    codes = street()
    _, stream = write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48)
    assert len(codes.voxels) > 18_000
    assert 8 * len(stream) / len(codes.voxels) < 6.0


def test_a_stream_cut_short_is_read_within_bounds_or_refused():
    codes = street(20)
    form, stream = write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48)
    for size in (0, 1, 10, len(stream) // 2):
        try:
            read, _ = read_points(form, stream[:size])
        except DataLoss:
            continue
        assert len(read.voxels) == form.count
        assert read.planes[:, :2].min() >= 0 and read.planes[:, :2].max() <= 30


def test_a_damaged_stream_is_read_within_bounds_or_refused():
    codes, rng = random_codes(np.random.default_rng(7), 400, 6), np.random.default_rng(8)
    form, stream = write_points(codes, np.zeros((len(codes.voxels), 0), np.int32), 15, 48, 2)
    for _ in range(180):
        damaged = np.frombuffer(stream, np.uint8).copy()
        damaged[rng.integers(len(damaged), size=4)] = rng.integers(0, 256, 4)
        try:
            read, _ = read_points(form, damaged.tobytes())
        except DataLoss:
            continue
        assert len(read.voxels) == form.count
        assert read.planes[:, :2].min() >= 0 and read.planes[:, :2].max() <= 30
        assert read.planes[:, 3].min() >= 0 and read.planes[:, 3].max() <= 3


def test_a_lone_normal_is_written_coarsely_and_level_ground_as_level():
    voxels = np.array([[0, 0, 0], [9, 9, 0], [0, 9, 9], [9, 0, 9]], np.int32)
    planes = np.array([[15, 15, 3, 0], [16, 14, -2, 0], [15, 15, 0, 0], [3, 27, 1, 0]], np.int32)
    codes, nothing = PlaneCodes(voxels, planes), np.zeros((4, 0), np.int32)
    before, after = (
        in_order(codes, nothing),
        in_order(read_points(*write_points(codes, nothing, 15, 48, 2))[0], nothing),
    )
    assert np.all((after[:, 3:5] - 15) % 2 == 0) and 0 < np.abs(before[:, 3:5] - after[:, 3:5]).max() <= 4
    floor = np.array([[x, y, 0] for x in range(9) for y in range(9)], np.int32)
    level = np.column_stack([np.full((81, 2), 15), np.zeros((81, 2))]).astype(np.int32)
    read, _ = read_points(*write_points(PlaneCodes(floor, level), np.zeros((81, 0), np.int32), 15, 48, 2))
    assert np.all(read.planes[:, :2] == 15)


@pytest.mark.parametrize(
    "damage", [{"count": -1}, {"count": 1 << 40}, {"depth": 99}, {"low": (0, 0)}, {"features": 1 << 20},
               {"normal_steps": 0}, {"offset_unit": 2.5}, {"count": True}, {"normal_unit": 99}],
)  # fmt: skip
def test_a_form_that_no_writer_writes_is_refused(damage):
    form = dataclasses.replace(Form(4, 0, (0, 0, 0), 3, 15, 48), **damage)
    with pytest.raises(DataLoss):
        read_points(form, b"1234")


def test_numbers_of_any_size_come_back():
    values = [0, 1, -1, 11, 12, -12, 13, 500, -65_535, 65_000, 0, 0]
    data, models = np.zeros(200, np.uint8), fresh_models(14)
    coder = start(data, False)
    for value in values:
        code_number(coder, data, models, 0, value)
    used = finish(coder, data)
    coder, models = start(data[:used], True), fresh_models(14)
    assert [code_number(coder, data[:used], models, 0, 0) for _ in values] == values


def test_a_buffer_that_is_too_small_is_not_overrun_and_its_need_is_told():
    data = np.zeros(8, np.uint8)
    room, models = data[:4], fresh_models(14)
    coder = start(room, False)
    for value in range(-40, 40):
        code_number(coder, room, models, 0, 7 * value)
    assert finish(coder, room) > 4
    assert not data[4:].any()
