"""Swept and collected goes what no row names for an hour, and nothing else."""

from __future__ import annotations

import os
import time
from contextlib import nullcontext
from pathlib import Path

import pytest

from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.files.blobs import nothing_deleted
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect, sweep
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


async def swept(world, unreferenced_s: float = UNREFERENCED_S) -> int:
    """Sweep, let the hour pass and collect; how many blobs went."""
    await sweep(world.context.storage)
    world.clock.ms += int(unreferenced_s * 1000)
    return await collect(world.context.storage)


def age(home: Path, by_s: float = 2 * UNREFERENCED_S) -> None:
    for path in files(home):
        os.utime(path, (time.time() - by_s,) * 2)


async def test_orphans_of_every_tenant_and_kind_go_and_what_is_named_stays(world, tmp_path):
    kept = files(tmp_path)
    for tenant, kind in ((TENANT, "cloud"), (TENANT, "mesh"), (OTHER, "neural-map"), (OTHER, "query-cloud")):
        world.context.blobs.put(tenant, kind, b"nobody names me")
    age(tmp_path)
    assert len(kept) == 6
    assert await swept(world) == 4
    assert files(tmp_path) == kept
    assert await swept(world) == 0


async def test_a_stray_has_its_hour_from_the_sweep_that_found_it(world, tmp_path):
    world.context.blobs.put(TENANT, "cloud", b"nobody names me")
    age(tmp_path)
    assert await swept(world, UNREFERENCED_S - 1.0) == 0
    assert await sweep(world.context.storage) == 0, "a second sweep begins it anew"
    assert await swept(world, 1.0) == 1


async def test_the_same_content_of_another_tenant_is_another_blob(world, tmp_path):
    named = next(path for path in files(tmp_path) if "/cloud/" in path.as_posix())
    world.context.blobs.put(OTHER, "cloud", named.read_bytes())
    age(tmp_path)
    assert await swept(world) == 1
    assert named.exists() and len(files(tmp_path)) == 6


async def test_what_is_young_may_still_get_its_row(world, tmp_path):
    world.context.blobs.put(TENANT, "cloud", b"its row comes in a moment")
    assert await swept(world) == 0
    assert len(files(tmp_path)) == 7


async def test_files_that_a_crash_left_half_written_go(world, tmp_path):
    named = next(iter(files(tmp_path)))
    half = named.with_name(f".{named.name}.123.abcd")
    half.write_bytes(named.read_bytes()[:10])
    age(tmp_path)
    await swept(world)
    assert not half.exists() and named.exists()


async def test_a_kind_of_another_version_stays(world, tmp_path):
    world.context.blobs.put(TENANT, "hologram", b"from the future")
    age(tmp_path)
    assert await swept(world) == 0
    assert len(files(tmp_path)) == 7


async def test_what_was_deleted_goes_after_an_hour_and_during_a_backup_with_the_next_sweep(world, tmp_path):
    for submap_id, kept in (("s0", 6), ("s1", 3)):
        await world.use_cases.submaps.delete(TENANT, submap(submap_id, 0).key)
        world.clock.ms += int(UNREFERENCED_S * 1000)
        with nothing_deleted(tmp_path / "blobs") if kept == 6 else nullcontext():
            await collect(world.context.storage)
        assert len(files(tmp_path)) == kept
    world.clock.ms += int(UNREFERENCED_S * 1000)
    assert await collect(world.context.storage) == 0
    age(tmp_path)
    assert await swept(world) == 3
    assert files(tmp_path) == set()
