"""Blobs that a process has read lately: the last ones, the small ones, within a number of bytes."""

from __future__ import annotations

from revisit.service.engines.s3.recent_blobs import LARGEST_BYTES, RecentBlobs


def test_what_was_not_asked_for_longest_goes_first():
    recent = RecentBlobs(30)
    for key in ("a", "b", "c"):
        recent.keep(key, bytes(10))
    assert recent.get("a") == bytes(10)
    recent.keep("d", bytes(10))
    assert [recent.get(key) is None for key in ("a", "b", "c", "d")] == [False, True, False, False]


def test_bytes_are_counted_once_for_a_key_and_given_back():
    recent = RecentBlobs(20)
    for _ in range(5):
        recent.keep("a", bytes(10))
    recent.keep("b", bytes(10))
    assert recent.get("a") == recent.get("b") == bytes(10)
    recent.drop(["a", "nobody"])
    recent.keep("c", bytes(10))
    assert recent.get("a") is None and recent.get("b") == recent.get("c") == bytes(10)


def test_a_large_blob_is_not_kept():
    recent = RecentBlobs()
    recent.keep("cloud", bytes(LARGEST_BYTES + 1))
    recent.keep("place", bytes(LARGEST_BYTES))
    assert recent.get("cloud") is None and recent.get("place") is not None
