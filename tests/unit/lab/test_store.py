"""What a drive takes on the disk."""

from __future__ import annotations

import subprocess

import pytest

from lab.storage.weighing import WeighedStore, store_table, weigh


@pytest.fixture
def home(tmp_path):
    for name, size in {
        "blobs/default/cloud/ab/abc": 100_000, "blobs/default/neural-map/ab/abd": 30_000,
        "blobs/default/signature/cd/cde": 9_000, "blobs/default/mesh/ef/eff": 50_000, "revisit.db": 70_000,
        "revisit.db-wal": 10_000, "index/maps": 5_000, "reserve": 400_000,
    }.items():  # fmt: skip
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"x" * size)
    return tmp_path


def test_a_store_is_weighed_as_du_does_without_its_reserve(home):
    parts = weigh(home)
    assert parts.keys() == {"scans", "places", "neural maps", "mesh", "database", "other"}
    said = subprocess.run(["du", "-s", "-B1", "--exclude=reserve", home], capture_output=True, text=True, check=True)
    assert sum(parts.values()) == int(said.stdout.split()[0]) - home.lstat().st_blocks * 512


def test_a_kilometre_without_scans_holds_everything_else():
    parts = {"scans": 200_000_000, "places": 2_000_000, "database": 3_000_000, "other": 500_000}
    row = WeighedStore("a street", 500.0, 100, 500, parts)
    assert row.megabytes_a_km(scans=False) == pytest.approx(11.0)
    assert row.megabytes_a_km(scans=True) == pytest.approx(411.0)
    line = store_table([row]).splitlines()[-1]
    assert line == "| a street | 500 m | 100 | 500 | 400 kB | 30.0 kB | 20.0 kB | 500 kB | 11.0 MB | 411.0 MB |"
