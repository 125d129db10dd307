"""A file that is cut short is refused. For other damage, and its cost, see tests/corpus/test_damage.py."""

from __future__ import annotations

from revisit.core.errors import MalformedBody, RevisitError
from revisit.formats import decode_cloud
from revisit.formats.cloud import DecodedCloud
from tests.corpus.damage import cuts


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
