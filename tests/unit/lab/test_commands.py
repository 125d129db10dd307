"""Every module of the lab loads, and each command of it says how it is called."""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path

import pytest

from revisit.service import ONE_THREAD
from tests.support.sources import ROOT

FILES = sorted((ROOT / "lab").rglob("*.py"))
RUNS_WHERE_IT_LOADS = ROOT / "lab/training/__main__.py"


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")


def is_command(path: Path) -> bool:
    return path.name == "__main__.py" or 'if __name__ == "__main__"' in path.read_text()


@pytest.mark.parametrize("path", [path for path in FILES if path != RUNS_WHERE_IT_LOADS], ids=name_of)
def test_a_module_of_the_lab_loads(path: Path) -> None:
    assert importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts)).__doc__


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("name", [name_of(path) for path in FILES if is_command(path)])
def test_a_command_of_the_lab_says_how_it_is_called(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for variable, threads in ONE_THREAD.items():
        monkeypatch.setenv(variable, threads)  # a command sets it: put back after the test
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_module(name, run_name="__main__", alter_sys=True)
    assert not end.value.code and "usage" in capsys.readouterr().out.lower()
