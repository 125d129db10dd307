"""A scan's way from the stream to the acknowledgement stays short."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
MOST = {"service/grpc/": 1, "service/wire/": 1, "service/application/": 5, "service/adapters/": 5, "": 18}
"""Modules that a scan may cross, by folder; the last is for all (docs/decisions/0084)."""


@pytest.fixture(scope="module")
def crossed():
    command = (sys.executable, "-m", "tests.support.way_of_a_scan")
    return subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=PATIENCE_S
    ).stdout.split()


@pytest.mark.parametrize("folder", MOST, ids=lambda folder: folder or "all")
def test_a_scan_crosses_few_modules(crossed, folder):
    found = [name for name in crossed if name.startswith(folder)]
    assert 0 < len(found) <= MOST[folder], found


def test_a_scan_passes_the_use_case_the_blobs_and_the_database(crossed):
    assert {"service/application/ingest/scans.py", "service/adapters/files/blobs.py"} <= set(crossed)
    assert any(name.startswith("service/adapters/sqlite/") for name in crossed)
