"""Rows of ASCII numbers, as PCD and PLY write them, parsed strictly and in bounded memory."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from core.errors import MalformedBody

CHUNK_BYTES = 2**20
MAX_TOKEN_BYTES = 64

# Stricter than float(): no underscores, no hexadecimal, no digits of other scripts, no NaN payloads.
_NUMBERS = re.compile(
    rb"(?:[+-]?(?:(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:e[+-]?[0-9]++)?|nan|inf(?:inity)?) )*+", re.IGNORECASE
)


def count_rows(body: bytes) -> int:
    """How many lines `body` holds; the last one need not end in LF, empty lines at the end do not count."""
    stripped_length = len(body.rstrip())
    return body.count(b"\n", 0, stripped_length) + 1 if stripped_length else 0


def parse_rows(body: bytes, rows: int, columns: int, wanted: list[int]) -> NDArray[np.float64]:
    """The `wanted` columns of `body`, which must hold exactly `rows` lines of `columns` numbers: (rows, w) float64.

    Memory stays near the size of the result. Raises MalformedBody for anything else, a number too large included.
    """
    if count_rows(body) != rows:
        raise MalformedBody(f"the header declares {rows} rows, the body holds {count_rows(body)}")
    values = np.empty((rows, len(wanted)))
    done = 0
    for chunk in _whole_lines(body.rstrip()):
        table = [line.split() for line in chunk.split(b"\n")]
        if any(len(row) != columns for row in table):
            raise MalformedBody(f"every row must have {columns} numbers")
        check_numbers([token for row in table for token in row])
        for target, column in enumerate(wanted):
            values[done : done + len(table), target] = [_number(row[column]) for row in table]
        done += len(table)
    return values


def check_numbers(tokens: list[bytes]) -> None:
    """Refuse tokens that are not plain decimal numbers, NaN or infinity. Raises MalformedBody."""
    if max(map(len, tokens), default=0) > MAX_TOKEN_BYTES:
        raise MalformedBody(f"a number has more than {MAX_TOKEN_BYTES} characters")
    if not _NUMBERS.fullmatch(b" ".join([*tokens, b""])):
        raise MalformedBody("the rows hold something that is not a decimal number")


def _number(token: bytes) -> float:
    value = float(token)
    if value in (np.inf, -np.inf) and b"n" not in token.lower():
        raise MalformedBody(f"the number {token.decode('ascii')} is too large")
    return value


def _whole_lines(body: bytes) -> Iterator[bytes]:
    """`body` in pieces of whole lines of about CHUNK_BYTES, without the LF between pieces."""
    start = 0
    while start < len(body):
        end = body.find(b"\n", start + CHUNK_BYTES)
        end = len(body) if end < 0 else end
        yield body[start:end]
        start = end + 1
