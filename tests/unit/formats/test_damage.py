"""Damaged files: a refusal or a cloud, never another exception, and never memory out of proportion."""

from __future__ import annotations

import random
import tracemalloc

import numpy as np
import pytest

from revisit.core.errors import MalformedBody, RevisitError
from revisit.formats import decode_cloud
from revisit.formats.cloud import DecodedCloud

FLIPS = 1000


def outcome(data: bytes, media_type: str) -> DecodedCloud | RevisitError:
    try:
        return decode_cloud(data, media_type)
    except RevisitError as error:
        return error


def test_a_file_cut_short_is_refused_at_every_one_of_64_places(valid_file):
    media_type, data = valid_file
    for step in range(64):
        length = len(data) * step // 64
        result = outcome(data[:length], media_type)
        # A headerless KITTI scan cut between two points is a shorter scan; nothing else may pass.
        if media_type.endswith("kitti.bin") and length and length % 16 == 0:
            assert isinstance(result, DecodedCloud)
        else:
            assert isinstance(result, MalformedBody), (length, result)


def test_flipped_bits_give_a_cloud_or_a_documented_error(valid_file):
    media_type, data = valid_file
    rng = random.Random(20_000 + len(data))
    for _ in range(FLIPS):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 1, 1, 8])):
            damaged[rng.randrange(min(len(data), 600) if rng.random() < 0.7 else len(data))] ^= 1 << rng.randrange(8)
        result = outcome(bytes(damaged), media_type)
        if isinstance(result, DecodedCloud):
            assert result.points.shape[1] == 3
            assert result.points.dtype == np.float32
            assert result.intensity is None or len(result.intensity) == len(result.points)


def test_damage_does_not_cost_memory(valid_file):
    media_type, data = valid_file
    outcome(data, media_type)
    rng = random.Random(5)
    tracemalloc.start()
    try:
        for _ in range(100):
            damaged = bytearray(data)
            damaged[rng.randrange(min(len(data), 300))] = rng.randrange(256)
            outcome(bytes(damaged), media_type)
        assert tracemalloc.get_traced_memory()[1] < 3 * len(data) + 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("seed", range(20))
def test_random_bytes_are_refused_under_every_content_type(seed):
    body = random.Random(seed).randbytes(333)
    for media_type in ("application/vnd.pcd", "model/ply", "application/vnd.npy", "application/vnd.revisit.quantised"):
        assert isinstance(outcome(body, media_type), MalformedBody)
