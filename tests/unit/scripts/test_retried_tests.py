"""Continuous integration keeps the names of the tests that it tried again, in a file and at its end."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
RACE, OTHER = "tests/unit/test_a.py::test_a_race[1 - 2]", "tests/unit/test_b.py::test_b"
MAKE = '#!/bin/bash\nif [ "$1" = test ]; then cat "$LOG"; exit "$TESTS"; fi\n'
PYTHON = f"""#!/bin/bash
if [ "$2" = pytest ]; then
    echo "== 1 passed in 0.1s =="
    exit "$AGAIN"
fi
exec {sys.executable} "$@"
"""


@pytest.fixture
def tree(tmp_path):
    """A checkout with `.ci/run`, whose tests say what a file says."""
    for name in (".ci/run", "scripts/retried_tests.py"):
        (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / "tree" / name)
    programs = {"bin/make": MAKE, "tree/.venv/bin/python": PYTHON, "tree/scripts/test_tools.sh": "#!/bin/bash\n"}
    for name, text in programs.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    return tmp_path


def ran(tree: Path, *failed: str, again: int = 0) -> subprocess.CompletedProcess[str]:
    """A run of `.ci/run` in which these tests failed beside others; `again`: the exit status when they ran alone."""
    lines = [*(f"FAILED {name} - AssertionError: at - last" for name in failed), "== 9 passed in 1.0s =="]
    (tree / "log").write_text("\n".join(lines) + "\n")
    variables = {"LOG": str(tree / "log"), "TESTS": str(int(bool(failed))), "AGAIN": str(again)}
    paths = {"PATH": f"{tree / 'bin'}:{os.environ['PATH']}"}
    command = ("bash", str(tree / "tree" / ".ci" / "run"))
    return subprocess.run(
        command, env={**os.environ, **variables, **paths}, capture_output=True, text=True, check=False
    )


def kept(tree: Path) -> list[str]:
    return (tree / "tree" / "build" / "retried-tests.txt").read_text().splitlines()


def test_the_names_of_retried_tests_are_kept_and_printed(tree):
    run = ran(tree, RACE, OTHER)
    assert run.returncode == 0 and kept(tree) == [RACE, OTHER]
    assert RACE in run.stdout.rpartition("tried again in this run")[2]


def test_the_log_of_the_tests_is_kept(tree):
    ran(tree, RACE)
    assert f"FAILED {RACE}" in (tree / "tree" / "build" / "tests.log").read_text()


def test_a_run_without_failures_keeps_an_empty_file(tree):
    assert ran(tree).returncode == 0 and kept(tree) == []


def test_a_test_that_fails_alone_too_fails_the_run(tree):
    assert ran(tree, RACE, again=1).returncode == 1


def test_four_failures_are_not_tried_again(tree):
    run = ran(tree, *(f"tests/test_{number}.py::test_it" for number in range(4)))
    assert run.returncode == 1 and kept(tree) == []
