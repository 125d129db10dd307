"""The bytes of a kilometre that the pages tell are those of a store, as `du` weighs it (simulated drive, 64 beams)."""

from __future__ import annotations

import asyncio
import re
from itertools import islice
from pathlib import Path

import pytest

from lab.storage.weighing import DATABASE, SCANS, weigh
from revisit.core.config import PipelineConfig
from revisit.sdk.clouds import encoded
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.ingest.clouds import EncodedCloud
from tests.support.retained import retained
from tests.support.service_world import SESSION, TENANT, open_session, sqlite_world
from tests.support.stored_rows import run

ROOT = Path(__file__).resolve().parents[2]
DRIVEN_SCANS = 41
SUBMAPS_A_KM = 200
EMPTY_FOLDERS = 257 * 4096
"""Of the first two digits of the blobs' hashes: they stay."""
WITHIN = 0.25
"""The longer drive of the page goes along other streets."""


def told(name: str) -> float:
    """Megabytes of a kilometre, as the page of measurements has them."""
    page = (ROOT / "docs/reference/measurements.md").read_text()
    (found,) = re.findall(rf"\*\*a kilometre {name}\*\*[^|]*\| \*\*([\d.]+) MB\*\*", page)
    return float(found)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Bytes on the disk by part, of a store with a scan a metre, and after retention removed the scans; how many
    submaps it has, and scans that these are described from.
    """
    return asyncio.run(measured(tmp_path_factory.mktemp("drive")))


async def measured(home: Path) -> tuple[dict[str, int], dict[str, int], int, int]:
    from lab.storage.drives import simulated_drive  # with all that the lab draws its figures with

    world = sqlite_world(home)
    await open_session(world)
    empty = weighed(home)
    _, _, scans = simulated_drive()
    for seq, scan in enumerate(islice(scans, DRIVEN_SCANS), 1):
        sent = encoded(scan.points)
        cloud = EncodedCloud(sent.data, sent.content_type)
        await world.use_cases.scans.append(TENANT, AppendScan(SESSION, seq, scan.stamp_ns, scan.T_odom_sensor, cloud))
    await world.use_cases.sessions.finish(TENANT, SESSION)
    world.work_off(load_recogniser())
    whole = weighed(home)
    chosen = run(home / "revisit.db", "SELECT count(*) FROM scans WHERE chosen")[0][0]
    await retained(world, "scans=none")
    without = weighed(home)
    submaps = run(home / "revisit.db", "SELECT count(*) FROM submaps WHERE state = 'DESCRIBED'")[0][0]
    world.context.transactions.close()
    whole[DATABASE] -= empty[DATABASE]
    return whole, without, submaps, chosen


def weighed(home: Path) -> dict[str, int]:
    run(home / "revisit.db", "PRAGMA wal_checkpoint(TRUNCATE)")
    return weigh(home)


def test_a_kilometre_takes_what_the_page_tells_with_and_without_its_scans(parts):
    whole, _, submaps, chosen = parts
    a_submap = whole["neural maps"] + whole["places"] + whole[DATABASE]
    without = 1e-6 * SUBMAPS_A_KM * a_submap / submaps
    assert without == pytest.approx(told(r"without its scans"), rel=WITHIN)
    scans = 1e-6 * 1000 * whole[SCANS] / DRIVEN_SCANS
    assert without + scans == pytest.approx(told(r"with a scan a metre"), rel=WITHIN)
    assert without + scans * chosen / DRIVEN_SCANS == pytest.approx(told(r"with its described scans"), rel=WITHIN)


def test_a_policy_leaves_a_kilometre_without_its_scans(parts):
    whole, without, submaps, _ = parts
    assert submaps >= DRIVEN_SCANS // PipelineConfig().submap.stride - 2
    assert without[SCANS] <= EMPTY_FOLDERS
    assert (without["neural maps"], without["places"]) == (whole["neural maps"], whole["places"])
