"""The line-by-line ASCII headers of PCD and PLY, and their strict numbers."""

from __future__ import annotations

import re

from revisit.core.errors import MalformedBody

MAX_LINE_BYTES = 4096
MAX_HEADER_BYTES = 65_536
MAX_HEADER_LINES = 1024

_NATURAL = re.compile(r"[0-9]{1,19}")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.\-]{0,63}")


def read_header(data: bytes, last_keyword: str) -> tuple[list[list[str]], int]:
    """The words of each header line up to the one that starts with `last_keyword`, and where the body starts.

    Lines end in LF or CRLF. Raises MalformedBody for a header that is too long or never ends.
    """
    lines: list[list[str]] = []
    start = 0
    while len(lines) < MAX_HEADER_LINES and start < MAX_HEADER_BYTES:
        end = data.find(b"\n", start, start + MAX_LINE_BYTES)
        if end < 0:
            raise MalformedBody(f"a header line does not end, or is longer than {MAX_LINE_BYTES} bytes")
        words = data[start:end].decode("latin-1").split()
        lines.append(words)
        start = end + 1
        if words and words[0] == last_keyword:
            return lines, start
    raise MalformedBody(f"the header has no {last_keyword} within {MAX_HEADER_BYTES} bytes")


def natural(word: str, what: str) -> int:
    """`word` as an integer >= 0 written in at most 19 ASCII digits. Raises MalformedBody."""
    if not _NATURAL.fullmatch(word):
        raise MalformedBody(f"{what} must be a whole number, got {word[:40]!r}")
    return int(word)


def field_name(word: str) -> str:
    """`word` as the name of a field: 1 to 64 ASCII letters, digits, `_`, `.`, `-`. Raises MalformedBody."""
    if not _NAME.fullmatch(word):
        raise MalformedBody(f"a field has an unusable name: {word[:40]!r}")
    return word
