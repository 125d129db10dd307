"""The bodies of requests that are not clouds (rows J and R), by file name; small ones stand in expected.toml itself."""

from __future__ import annotations

import json

from tests.corpus.clouds import Bodies


def request_bodies() -> Bodies:
    """All of them."""
    wrong = {"map_id": "x", **{f"f{number}": number for number in range(30_000)}}
    return {
        "I06-id-of-1-mb.json": lambda: json.dumps({"map_id": "a" * 1_000_000}).encode(),
        "I10-10000-emoji.json": lambda: json.dumps({"map_id": "i10", "display_name": "\U0001f600" * 10_000}).encode(),
        "J02-5000-digits.json": lambda: b'{"map_id": "x", "leave_distance_m": ' + b"9" * 5000 + b"}",
        "J03-200000-brackets.json": lambda: b"[" * 200_000,
        # Every quote but the first is escaped: a matcher that tries again at each of them takes quadratic time.
        "J03-string-without-end.json": lambda: b'{"map_id": "' + b'\\"' * 400_000,
        "J03-17-levels.json": lambda: b"[" * 17 + b"]" * 17,
        "J07-utf-16.json": lambda: '{"map_id": "x"}'.encode("utf-16"),
        "J07-byte-order-mark.json": lambda: b'\xef\xbb\xbf{"map_id": "x"}',
        "J08-400-kb-of-wrong-items.json": lambda: json.dumps(wrong).encode(),
        # Field 1, groups within groups; a parser that follows them recurses.
        "R03-depth-20000.wire": lambda: b"\x0b" * 20_000,
        "R03-depth-200.wire": lambda: b"\x0b" * 200,
    }
