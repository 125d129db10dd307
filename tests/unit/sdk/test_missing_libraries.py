"""A command that misses a library ends with one line, which names the extra that brings it."""

from __future__ import annotations

import sys

import pytest

from revisit.cli.extras import needs


@pytest.fixture
def without_torch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "revisit.core.implicit_map.gradient_steps", raising=False)


def test_a_learned_field_without_torch_is_refused_in_one_line(without_torch):
    @needs("service")
    def fit():
        import revisit.core.implicit_map.gradient_steps  # noqa: F401

    with pytest.raises(SystemExit) as refused:
        fit()
    told = "revisit: a learned field is fitted with torch, which is not installed: pip install 'revisit-loops[learned]'"
    assert str(refused.value) == told


def test_an_import_that_fails_inside_revisit_is_no_missing_library():
    @needs("service")
    def broken():
        from revisit.sdk.client import Nothing  # noqa: F401

    with pytest.raises(ImportError, match="Nothing"):
        broken()
