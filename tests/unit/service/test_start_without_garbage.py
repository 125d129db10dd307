"""A process that starts makes next to no garbage: nobody looks for any until it serves or takes jobs."""

from __future__ import annotations

import gc

import pytest

from revisit.service import composition
from revisit.service.__main__ import main
from tests.support.made_database import made_database


@pytest.fixture
def seen(monkeypatch, tmp_path):
    """Whether garbage was looked for, each time that something of a start was done."""
    looks = []
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    made_database(tmp_path / "revisit.db")
    monkeypatch.setattr("revisit.service.gateway.serve", lambda *_: looks.append(gc.isenabled()) or 0)
    monkeypatch.setattr(composition, "run_worker", lambda *_: looks.append(gc.isenabled()))
    yield looks
    gc.enable()


@pytest.mark.parametrize("command", ["serve", "worker"])
def test_nobody_looks_for_garbage_while_a_process_starts_and_somebody_does_afterwards(seen, monkeypatch, command):
    monkeypatch.setattr("revisit.service.__main__.leave_out_optional_libraries", lambda: None)
    assert main([command]) == 0
    assert (seen, gc.isenabled()) == ([False], True)
