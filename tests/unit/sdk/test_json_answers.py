"""Answers over REST that are not as this version of the service writes them."""

from __future__ import annotations

import math

import pytest
from google.protobuf.json_format import ParseError

from revisit.sdk.json_answers import message_of
from revisit.v1 import loop_closure_pb2, map_tile_pb2, session_pb2


def test_fields_and_names_of_a_newer_service_are_ignored():
    answer = {"name": "s", "colour": {"deep": ["red"]}, "state": "HIBERNATING", "committed_seq": "7", "robot": None}
    assert message_of(session_pb2.Session, answer) == session_pb2.Session(name="s", committed_seq=7)


def test_numbers_that_json_lacks_are_read():
    loop = message_of(loop_closure_pb2.LoopClosure, {"score": "NaN", "similarity": "-Infinity"})
    assert math.isnan(loop.score)
    assert loop.similarity == -math.inf


def test_bytes_are_read():
    tile = next(m for m in map_tile_pb2.DESCRIPTOR.message_types_by_name.values() if "data" in m.fields_by_name)
    assert message_of(getattr(map_tile_pb2, tile.name), {"data": "YWJj"}).data == b"abc"


@pytest.mark.parametrize(
    "answer", [[], "text", 3, {"committed_seq": "many"}, {"name": {"a": 1}}, {"findings": {"a": 1}}]
)
def test_what_is_no_such_message_is_refused(answer):
    with pytest.raises((ValueError, ParseError)):
        message_of(session_pb2.Session, answer)
