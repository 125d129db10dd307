"""Bounds of a client's input: their ends belong to them, and what lies beyond is refused by name."""

from __future__ import annotations

import math
import re

import pytest

from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.limits import Range
from revisit.service.domain.loop_policy import BOUNDS, LoopPolicy

RANGES = {name: value for name, value in vars(limits).items() if isinstance(value, Range)}


@pytest.mark.parametrize("name", RANGES)
def test_both_ends_of_a_range_are_taken_and_what_lies_beyond_is_refused(name):
    bounds = RANGES[name]
    assert (bounds.least in bounds) is not bounds.above and bounds.most in bounds
    beyond = [bounds.least - 1, bounds.most + 1, math.nan, math.inf, -math.inf, 10**400, -(10**400)]
    for value in beyond:
        with pytest.raises(BadField, match=r"^it must be in ") as refused:
            bounds.validated(value, "it")
        assert refused.value.field == "it"


def test_a_range_names_its_ends_its_unit_and_what_it_excludes():
    assert str(limits.TAU_M) == "0.1..1000 metres"
    assert str(limits.RADIUS_M) == "0..1000000 metres, without 0"
    assert str(limits.MIN_SEQ) == "0..2^63 - 1"


def test_the_pattern_of_ids_allows_as_many_characters_as_is_said():
    assert re.fullmatch(limits.ID_PATTERN, "x" * limits.ID_CHARACTERS)
    assert not re.fullmatch(limits.ID_PATTERN, "x" * (limits.ID_CHARACTERS + 1))


@pytest.mark.parametrize("field", BOUNDS)
def test_a_loop_policy_beyond_a_bound_is_refused_by_the_name_of_the_field(field):
    for good in (BOUNDS[field].least, BOUNDS[field].most, None):
        assert LoopPolicy(**{field: good}).validated() == LoopPolicy(**{field: good})
    with pytest.raises(BadField, match=rf"^loop_policy\.{field} must be in "):
        LoopPolicy(**{field: BOUNDS[field].most + 1}).validated()
