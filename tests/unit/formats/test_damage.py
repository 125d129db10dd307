"""Damaged files: a refusal or a cloud, never another exception, and never memory out of proportion."""

from __future__ import annotations

import random
import tracemalloc

import numpy as np
import pytest

from revisit.core.errors import MalformedBody, RevisitError
from revisit.formats import decode_cloud
from revisit.formats.cloud import DecodedCloud
from tests.corpus.damage import cuts, flips

FLIPS = 1000


def outcome(data: bytes, media_type: str) -> DecodedCloud | RevisitError:
    try:
        return decode_cloud(data, media_type)
    except RevisitError as error:
        return error


def test_a_file_cut_short_is_refused_at_every_one_of_64_places(valid_file):
    media_type, data = valid_file
    for cut in cuts(data, 64):
        result = outcome(cut, media_type)
        # A headerless KITTI scan cut between two points is a shorter scan; nothing else may pass.
        if media_type.endswith("kitti.bin") and cut and len(cut) % 16 == 0:
            assert isinstance(result, DecodedCloud)
        else:
            assert isinstance(result, MalformedBody), (len(cut), result)


def test_flipped_bits_give_a_cloud_or_a_documented_error(valid_file):
    media_type, data = valid_file
    for damaged in flips(data, FLIPS, random.Random(20_000 + len(data))):
        result = outcome(damaged, media_type)
        if isinstance(result, DecodedCloud):
            assert result.points.shape[1] == 3
            assert result.points.dtype == np.float32
            assert result.intensity is None or len(result.intensity) == len(result.points)


def test_damage_does_not_cost_memory(valid_file):
    media_type, data = valid_file
    outcome(data, media_type)
    tracemalloc.start()
    try:
        for damaged in flips(data, 100, random.Random(5)):
            outcome(damaged, media_type)
        assert tracemalloc.get_traced_memory()[1] < 3 * len(data) + 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("seed", range(20))
def test_random_bytes_are_refused_under_every_content_type(seed):
    body = random.Random(seed).randbytes(333)
    for media_type in ("application/vnd.pcd", "model/ply", "application/vnd.npy", "application/vnd.revisit.quantised"):
        assert isinstance(outcome(body, media_type), MalformedBody)
