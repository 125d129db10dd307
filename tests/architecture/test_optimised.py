"""Python may run with -O, which drops assert statements: nothing the product checks may hang on one (ruff, S101)."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests.support.sources import ROOT

# Parsers and indexes: where a dropped check would mean a crash of a library instead of an error.
SUBSET = (
    "tests/unit/formats/test_bad_input.py",
    "tests/contract/test_place_index.py",
    "tests/contract/test_vector_index.py",
)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_parsers_and_indexes_refuse_the_same_input_without_assert_statements():
    optimised = {**os.environ, "PYTHONOPTIMIZE": "1"}
    probe = subprocess.run([sys.executable, "-c", "assert False"], env=optimised, check=False, capture_output=True)
    assert probe.returncode == 0, "-O was not in force"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "ignore", *SUBSET]
    run = subprocess.run(command, cwd=ROOT, env=optimised, capture_output=True, text=True, check=False, timeout=850)
    assert run.returncode == 0, run.stdout[-3000:]
    assert int(re.search(r"(\d+) passed", run.stdout)[1]) >= 150
