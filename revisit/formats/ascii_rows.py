"""Rows of ASCII numbers, as PCD and PLY write them, parsed strictly and in bounded memory."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody

CHUNK_BYTES = 2**17
"""Of one look at the text, during which no other thread of Python runs: about 2 ms."""
MAX_TOKEN_BYTES = 64


def greedy(pattern: bytes) -> bytes:
    """A pattern whose repetitions may give back, for Python 3.10: it fits the same text, and refuses others later."""
    return re.sub(rb"([*+?])\+", rb"\1", pattern)


def _compiled(pattern: bytes) -> re.Pattern[bytes]:
    try:
        return re.compile(pattern, re.IGNORECASE)
    except re.error:
        return re.compile(greedy(pattern), re.IGNORECASE)


# Stricter than strtod and float(): no underscores, no hexadecimal, no digits of other scripts, no NaN payloads.
NUMBERS = (
    rb"[ \t\r\n]*+(?:[+-]?(?:(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:e[+-]?[0-9]++)?|nan|inf(?:inity)?)(?:[ \t\r\n]++|\Z))*+"
)
_NUMBERS = _compiled(NUMBERS)


@dataclass(frozen=True)
class NumberLines:
    """Consecutive lines of numbers: values (t,) float64 of all of them, counts (r,) int64 of numbers per line."""

    values: NDArray[np.float64]
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        """How many lines there are."""
        return len(self.counts)

    def between(self, first: int, last: int) -> NumberLines:
        """The lines first..last-1."""
        start = int(self.counts[:first].sum())
        counts = self.counts[first:last]
        return NumberLines(self.values[start : start + int(counts.sum())], counts)

    def table(self, columns: int) -> NDArray[np.float64]:
        """The lines as (r, columns). Raises MalformedBody unless every line has that many numbers."""
        if (self.counts != columns).any():
            raise MalformedBody(f"every row must have {columns} numbers")
        return self.values.reshape(-1, columns)

    def check_lists(self, is_list: list[bool]) -> None:
        """Refuse lines that do not hold, per property, one number or a length and as many numbers: MalformedBody."""
        position = np.cumsum(self.counts) - self.counts
        end = position + self.counts
        for has_length in is_list:
            if (position >= end).any():
                raise MalformedBody("a row has fewer numbers than its element declares")
            length = self.values[position] if has_length else np.zeros(len(self))
            if not ((length >= 0) & (length <= len(self.values)) & (length == np.floor(length))).all():
                raise MalformedBody("the length of a list must be a whole number that the row can hold")
            position = position + 1 + length.astype(np.int64)
        if (position != end).any():
            raise MalformedBody("a row does not have the numbers that its element declares")


def count_rows(body: bytes) -> int:
    """How many lines `body` holds; the last one need not end in LF, empty lines at the end do not count."""
    stripped_length = len(body.rstrip())
    return body.count(b"\n", 0, stripped_length) + 1 if stripped_length else 0


def number_lines(body: bytes) -> Iterator[NumberLines]:
    """All lines of `body`, 128 kB at a time. Raises MalformedBody for anything but decimal numbers."""
    body = body.rstrip()
    start = 0
    while start < len(body):
        end = body.find(b"\n", start + CHUNK_BYTES)
        end = len(body) if end < 0 else end + 1
        yield _parse(body[start:end])
        start = end


def parse_rows(body: bytes, rows: int, columns: int, wanted: list[int]) -> NDArray[np.float64]:
    """The `wanted` columns of `body`, which must hold exactly `rows` lines of `columns` numbers: (rows, w) float64.

    Raises MalformedBody for anything else, a number too large for a float64 included.
    """
    if count_rows(body) != rows:
        raise MalformedBody(f"the header declares {rows} rows, the body holds {count_rows(body)}")
    tables = [lines.table(columns)[:, wanted] for lines in number_lines(body)]
    return np.concatenate(tables) if tables else np.empty((0, len(wanted)))


def _parse(chunk: bytes) -> NumberLines:
    """The numbers of whole lines."""
    if not _NUMBERS.fullmatch(chunk):
        raise MalformedBody("the rows hold something that is not a decimal number")
    text = np.frombuffer(chunk, dtype=np.uint8)
    in_token = np.concatenate([[False], text > ord(" "), [False]])
    edges = np.flatnonzero(in_token[1:] != in_token[:-1])
    starts, ends = edges[::2], edges[1::2]
    if (ends - starts).max(initial=0) > MAX_TOKEN_BYTES:
        raise MalformedBody(f"a number has more than {MAX_TOKEN_BYTES} characters")
    values = np.fromstring(chunk.decode("ascii"), sep=" ")
    if len(values) != len(starts) or int(np.isinf(values).sum()) != chunk.lower().count(b"inf"):
        raise MalformedBody("a number is too large, or cannot be read")
    line_ends = np.flatnonzero(text == ord("\n"))
    if not chunk.endswith(b"\n"):
        line_ends = np.append(line_ends, len(chunk))
    return NumberLines(values, np.diff(np.searchsorted(starts, line_ends), prepend=0))
