"""A scan's way from the client's channel to the acknowledgement stays short."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
MOST = {
    "open": {"": 36},
    "scan": {
        "service/grpc/": 4,
        "service/wire/": 1,
        "service/features/": 3,
        "service/capacity/": 3,
        "service/engines/": 12,
        "": 31,
    },
    "end": {"": 13},
}
"""Modules that each leg of a stream may cross, by folder; the last is for all."""

LIMITS = [(leg, folder, most) for leg, by_folder in MOST.items() for folder, most in by_folder.items()]


@pytest.fixture(scope="module")
def crossed():
    command = (sys.executable, "-m", "tests.support.way_of_a_scan")
    ran = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=2 * PATIENCE_S)
    return [tuple(line.split()) for line in ran.stdout.splitlines()]


@pytest.mark.parametrize(
    ("leg", "folder", "most"), LIMITS, ids=[f"{leg} {folder or 'all'}" for leg, folder, _ in LIMITS]
)
def test_a_scan_crosses_few_modules(crossed, leg, folder, most):
    found = [name for of, name in crossed if of == leg and name.startswith(folder)]
    assert 0 < len(found) <= most, found


def test_a_scan_passes_the_interceptors_the_use_case_the_blobs_and_the_database(crossed):
    modules = {name for leg, name in crossed if leg == "scan"}
    interceptors = {"service/grpc/errors.py", "service/grpc/tracing.py"}
    assert {*interceptors, "service/features/ingest/calls.py", "service/engines/local/files/blobs.py"} <= modules
    assert any(name.startswith("service/engines/local/sqlite/") for name in modules)


def test_opening_a_stream_asks_who_calls(crossed):
    opening = {name for leg, name in crossed if leg == "open"}
    assert {"service/grpc/access.py", "service/features/keys/admission.py"} <= opening
