"""What is computed of something immutable is computed once."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

from revisit.core.place.kept import Keeping


@dataclass(frozen=True)
class Number(Keeping):
    """A number that counts how often it is looked at."""

    value: int
    looks: list[int]


def times(number: Number, factor: int = 2) -> int:
    """The number multiplied; the look is counted."""
    number.looks.append(factor)
    return number.value * factor


def test_an_answer_is_computed_once_for_each_argument() -> None:
    number = Number(7, [])
    assert [number.kept(times), number.kept(times, 3), number.kept(times, 3), number.kept(times)] == [14, 21, 21, 14]
    assert number.looks == [2, 3]
    assert Number(8, []).kept(times) == 16


def test_what_is_kept_does_not_travel() -> None:
    number = Number(7, [])
    empty = len(pickle.dumps(number))
    number.kept(times, 10**40)
    number.looks.clear()
    assert len(pickle.dumps(number)) == empty
    assert pickle.loads(pickle.dumps(number)) == number
