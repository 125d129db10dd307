"""`revisit plan` counts what a small service really stores: rows exactly, bytes in order of magnitude."""

from __future__ import annotations

import asyncio
import json
import re

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.sizing import Fleet, constants, kept_share, limits_of, need_of, value
from revisit.core.config import PipelineConfig
from revisit.service.domain.retention import parsed
from tests.support.processes import ROOT
from tests.support.retained import disk_bytes, driven, retained
from tests.support.service_world import sqlite_world
from tests.support.stored_rows import run

SCANS = 400
COMMITS = "docs/decisions/0328-postgresql-beside-sqlite.md"
A_SCAN_A_METRE = {"hz": 1.0, "speed_m_s": 1.0}


def hours_of(metres: float) -> float:
    """How long a robot of 1 m/s drives for so many metres."""
    return metres / 3600.0


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The data of one robot's drive of `SCANS` metres; the last test takes its scans."""
    world = sqlite_world(tmp_path_factory.mktemp("stored"))
    asyncio.run(driven(world, SCANS))
    yield world
    world.context.transactions.close()


async def test_the_rows_of_one_robot_are_counted(stored):
    need = need_of(Fleet(1, **A_SCAN_A_METRE))
    rows = {
        table: run(stored.home / "revisit.db", f"SELECT count(*) FROM {table}")[0][0] for table in ("scans", "submaps")
    }
    tau_m = PipelineConfig().submap.tau
    assert rows["scans"] == round(need.scans_s * SCANS)
    assert rows["submaps"] == round(need.submaps_s * (SCANS - tau_m)) + 1


async def test_the_bytes_of_its_rows_are_of_the_order_planned(stored):
    database = stored.home / "revisit.db"
    run(database, "PRAGMA wal_checkpoint(TRUNCATE)")
    pairs, submaps = (run(database, f"SELECT count(*) FROM {table}")[0][0] for table in ("loop_closures", "submaps"))
    planned = SCANS * value("scan_row_bytes") + pairs * value("pair_row_bytes") + submaps * value("submap_row_bytes")
    assert planned / 3 <= database.stat().st_size <= 3 * planned


async def test_a_policy_leaves_what_was_planned(stored):
    planned = need_of(Fleet(1, days=1.0, hours_a_day=hours_of(SCANS), retention=parsed("scans=none"), **A_SCAN_A_METRE))
    clouds = stored.home / "blobs" / "default" / "cloud"
    assert planned.disk_bytes["scans"] == 0.0 < disk_bytes(clouds)
    await retained(stored, "scans=none")
    assert disk_bytes(clouds) == 0


def test_twice_the_robots_take_twice_as_much():
    one, two = need_of(Fleet(10)), need_of(Fleet(20))
    for name in ("submaps_s", "scans_s", "worker_cores", "gateway_cores", "row_writes_s", "network_mbit_s"):
        assert getattr(two, name) == pytest.approx(2 * getattr(one, name)), name
    assert two.disk_bytes_a_day == pytest.approx(2 * one.disk_bytes_a_day)


def test_the_shorter_scans_are_kept_the_less_disk_they_take():
    sizes = [
        need_of(Fleet(1, retention=parsed(text))).disk_bytes["scans"]
        for text in ("", "scans=described:24h", "scans=described", "scans=24h", "scans=1h", "scans=none")
    ]
    assert sizes[0] > sizes[1] > sizes[2] and sizes[1] > sizes[3] > sizes[4] > sizes[5] == 0.0


def test_a_scan_each_two_metres_is_all_that_a_description_takes():
    assert kept_share(Fleet(1, hz=0.5, retention=parsed("scans=described"))) == 1.0
    assert kept_share(Fleet(1, hz=10.0, retention=parsed("scans=described"))) == pytest.approx(0.05)
    assert kept_share(Fleet(1, 16, hz=10.0, retention=parsed("scans=described"))) == pytest.approx(0.2)


def test_one_gateway_ends_before_sqlite_does():
    ends = {one.choice: one.holds for robots in (1, 100) for one in limits_of(need_of(Fleet(robots)), 16, 4.0)}
    assert not ends["one gateway"] and not ends["SQLite"]
    assert all(one.holds for one in limits_of(need_of(Fleet(1, days=1.0)), 16, 4.0))


def test_a_database_ends_by_its_commits_before_it_does_by_its_rows():
    ends = {one.choice: one.holds for one in limits_of(need_of(Fleet(1_500, hz=0.5)), 16, 4.0)}
    assert ends["one PostgreSQL, rows"] and not ends["one PostgreSQL, commits"]


TOLD = {
    "worker_cpu_s_a_submap": ("docs/reference/measurements.md", r"everything included, .*?\| (\d+) CPU ms", 1e-3),
    "acknowledgements_s_postgres": (COMMITS, r"^\| 3 \| ([\d,]+) ", 1.0),
    "jobs_s_postgres": (COMMITS, r"claimed and completed (\d+) jobs/s", 1.0),
}
"""Constant -> the page with the latest figure of it, where it stands there, and its unit in that of the constant."""


@pytest.mark.parametrize("name", TOLD)
def test_a_constant_is_the_figure_that_was_measured_last(name):
    page, place, unit = TOLD[name]
    (figure,) = re.findall(place, (ROOT / page).read_text(), re.MULTILINE)
    assert value(name) == pytest.approx(unit * float(figure.replace(",", "")))


def test_each_constant_says_where_it_is_from():
    for name, one in constants().items():
        assert {"value", "unit", "command", "date", "machine"} == one.keys(), name
        assert all(one.values())


def test_the_command_prints_it_and_refuses_what_is_no_policy():
    told = CliRunner().invoke(app, ["plan", "--robots", "400", "--retention", "scans=24h"]).output
    assert "cores of workers" in told and "ends: " in told
    found = json.loads(CliRunner().invoke(app, ["plan", "--json"]).output)
    assert found["need"]["submaps_s"] == 0.2 and "worker_mib" in found["constants"]
    for wrong in (("--retention", "scans=often"), ("--disk-tb", "inf", "--json"), ("--days", "nan"), ("--hz", "0")):
        refused = CliRunner().invoke(app, ["plan", *wrong])
        assert refused.exit_code != 0 and isinstance(refused.exception, SystemExit), wrong
