"""A command that misses a library ends with one line, which names the extra that brings it."""

from __future__ import annotations

import sys

import pytest

from revisit.cli.extras import needs
from revisit.evaluation.described_submaps import in_processes


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


def doubled(context: int, task: int) -> int:
    if sys.modules.get("torch") is not None:
        raise AssertionError("torch was imported")
    return context * task


def test_processes_that_evaluate_the_product_need_no_torch():
    assert list(in_processes(doubled, 2, [1, 2, 3], jobs=2)) == [2, 4, 6]
