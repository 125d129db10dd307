"""The sweep deletes what no row names, and nothing else."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.files.blobs import nothing_deleted
from revisit.service.features.upkeep.sweeping import MIN_AGE_S, sweep
from tests.support.service_world import TENANT, open_session, sqlite_world, submap

OTHER = TenantId("other")


@pytest.fixture
async def world(tmp_path):
    """Two described submaps: 6 blobs."""
    opened = sqlite_world(tmp_path)
    await open_session(opened)
    for number in range(2):
        await opened.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    opened.work_off()
    yield opened
    opened.context.transactions.close()


def files(home: Path) -> set[Path]:
    return {path for path in (home / "blobs").rglob("*") if path.is_file()}


def age(home: Path, by_s: float = 2 * MIN_AGE_S) -> None:
    for path in files(home):
        os.utime(path, (time.time() - by_s,) * 2)


async def test_orphans_of_every_tenant_and_kind_go_and_what_is_named_stays(world, tmp_path):
    kept = files(tmp_path)
    for tenant, kind in ((TENANT, "cloud"), (TENANT, "mesh"), (OTHER, "neural-map"), (OTHER, "query-cloud")):
        world.context.blobs.put(tenant, kind, b"nobody names me")
    age(tmp_path)
    assert len(kept) == 6
    assert await sweep(world.context.storage) == 4
    assert files(tmp_path) == kept
    assert await sweep(world.context.storage) == 0


async def test_the_same_content_of_another_tenant_is_another_blob(world, tmp_path):
    named = next(path for path in files(tmp_path) if "/cloud/" in path.as_posix())
    world.context.blobs.put(OTHER, "cloud", named.read_bytes())
    age(tmp_path)
    assert await sweep(world.context.storage) == 1
    assert named.exists() and len(files(tmp_path)) == 6


async def test_what_is_young_may_still_get_its_row(world, tmp_path):
    world.context.blobs.put(TENANT, "cloud", b"its row comes in a moment")
    assert await sweep(world.context.storage) == 0
    assert len(files(tmp_path)) == 7


async def test_files_that_a_crash_left_half_written_go(world, tmp_path):
    named = next(iter(files(tmp_path)))
    half = named.with_name(f".{named.name}.123.abcd")
    half.write_bytes(named.read_bytes()[:10])
    age(tmp_path)
    await sweep(world.context.storage)
    assert not half.exists() and named.exists()


async def test_a_kind_of_another_version_stays(world, tmp_path):
    world.context.blobs.put(TENANT, "hologram", b"from the future")
    age(tmp_path)
    assert await sweep(world.context.storage) == 0
    assert len(files(tmp_path)) == 7


async def test_what_was_deleted_during_a_backup_goes_with_the_next_sweep(world, tmp_path):
    with nothing_deleted(tmp_path / "blobs"):
        await world.use_cases.submaps.delete(TENANT, submap("s0", 0).key)
        assert len(files(tmp_path)) == 6
    age(tmp_path)
    assert await sweep(world.context.storage) == 3
    assert len(files(tmp_path)) == 3
