"""Numbers and times in text files: one row a line, separated by blanks or commas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody

MICROSECOND_DIGITS, NANOSECOND_DIGITS = 15, 18


def read_rows(file: Path, width: int) -> NDArray[np.float64]:
    """The numbers (n, width) of a text file; lines that start with # are left out. Raises MalformedBody."""
    rows = [_numbers(words, file.name) for words in read_words(file)]
    if not rows or any(len(row) != width for row in rows):
        raise MalformedBody(f"{file.name} must hold {width} numbers a line")
    return np.array(rows, dtype=np.float64)


def read_times(file: Path) -> NDArray[np.int64]:
    """The times (n,) that begin the lines of a text file, nanoseconds, as `nanoseconds` reads them."""
    try:
        return np.array([nanoseconds(words[0]) for words in read_words(file)], dtype=np.int64)
    except MalformedBody as error:
        raise MalformedBody(f"{file.name}: {error.message}") from error


def nanoseconds(time: str) -> int:
    """The nanoseconds of a decimal number of seconds, exactly.

    A whole number of MICROSECOND_DIGITS or more is in microseconds, of NANOSECOND_DIGITS or more in nanoseconds:
    seconds would be beyond all calendars. Raises MalformedBody for no time, or one that 64 bits do not hold.
    """
    whole, _, fraction = time.partition(".")
    if whole.isdecimal() and (fraction.isdecimal() or not fraction):
        unit = _unit(len(whole)) if fraction == "" else 10**9
        found = int(whole) * unit + int(fraction.ljust(9, "0")[:9] or 0)
    else:
        try:
            found = round(float(time) * 1e9)
        except (ValueError, OverflowError) as error:
            raise MalformedBody(f"{time[:40]!r} is no time") from error
    if abs(found) >= 2**63:
        raise MalformedBody(f"{time[:40]!r} is no time in seconds")
    return found


def _unit(digits: int) -> int:
    """The nanoseconds of what a whole number of so many digits counts."""
    return 1 if digits >= NANOSECOND_DIGITS else 1000 if digits >= MICROSECOND_DIGITS else 10**9


def read_words(file: Path) -> list[list[str]]:
    """The words of every line that is neither empty nor a comment. Raises MalformedBody for bytes that are no text."""
    try:
        lines = file.read_text("utf-8-sig").replace(",", " ").splitlines()
    except UnicodeDecodeError as error:
        raise MalformedBody(f"{file.name} is no text file") from error
    return [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def keyed_matrix(file: Path, key: str, shape: tuple[int, int]) -> NDArray[np.float64]:
    """The matrix of a line `key: numbers`. Raises MalformedBody where it is missing or of another size."""
    for words in read_words(file):
        if words[0].rstrip(":") == key:
            numbers = _numbers([word for word in words[1:] if word != ":"], file.name)
            if len(numbers) != shape[0] * shape[1]:
                raise MalformedBody(f"{file.name}: {key} must hold {shape[0] * shape[1]} numbers, got {len(numbers)}")
            return np.array(numbers).reshape(shape)
    raise MalformedBody(f"{file.name} has no line `{key}:`")


def _numbers(words: list[str], name: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise MalformedBody(f"{name} must hold numbers: {error}") from error
