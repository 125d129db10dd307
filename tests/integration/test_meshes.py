"""Meshes are made of neural maps when somebody asks for one, and nothing of them is kept."""

from __future__ import annotations

import asyncio
import os
import time
from pathlib import Path

import pytest

from revisit.core.errors import ErrorCode, RevisitError
from revisit.service.domain.errors import NoAnswer, RateLimited, StorageFull, WorkersBusy
from revisit.service.domain.identity import SubmapKey
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect, sweep
from revisit.service.ports.blobs import MESH_BLOB
from revisit.service.ports.disk import UnlimitedDisk
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, TENANT, World, answered, described, sqlite_world, submap

A = SubmapKey(SESSION.map_id, SESSION.session_id, "a")


@pytest.fixture
def world(tmp_path):
    made = sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


def kept(home: Path, kind: str = MESH_BLOB) -> list[Path]:
    return list((home / "blobs").glob(f"*/{kind}/*/*"))


def asked(world: World, file_format: str | None = None, **how):
    return asyncio.ensure_future(world.use_cases.submaps.download(TENANT, A, DownloadKind.MESH, file_format, **how))


async def jobs_of(world: World) -> list[str]:
    listed = (await world.use_cases.operations.list(TENANT, PageRequest())).items
    return [one.state for one in listed if one.kind == "MAKE_MESH"]


async def some_job(world: World):
    async with asyncio.timeout(PATIENCE_S):
        while (lease := world.claim()) is None:
            await asyncio.sleep(0.005)
    return lease


async def nothing_left(home: Path) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while kept(home):
            await asyncio.sleep(0.005)


async def test_a_described_submap_keeps_no_mesh(world, tmp_path):
    await described(world, a=1)
    assert len(kept(tmp_path, "neural-map")) == 1
    assert kept(tmp_path) == []


@pytest.mark.parametrize(("file_format", "magic"), [(None, b"ply\n"), ("glb", b"glTF")])
async def test_a_mesh_is_made_by_a_worker_and_gone_when_it_was_read(world, tmp_path, file_format, magic):
    await described(world, a=1)
    file = await answered(world, asked(world, file_format))
    assert file.data.startswith(magic) and file.filename == f"monday-a-mesh.{file_format or 'ply'}"
    assert kept(tmp_path) == [] and await jobs_of(world) == ["DONE"]


async def test_two_who_ask_for_the_same_mesh_each_get_it(world, tmp_path):
    await described(world, a=1)
    first, second = asked(world), asked(world)
    files = await answered(world, asyncio.gather(first, second))
    assert files[0].data == files[1].data and kept(tmp_path) == []


async def test_a_mesh_waits_for_room_once_it_is_made_and_goes_where_there_is_none(world, tmp_path):
    await described(world, a=1)

    async def no_room(count: int) -> None:
        assert len(kept(tmp_path)) == 1 and count == kept(tmp_path)[0].stat().st_size - 16
        raise WorkersBusy("no room", retry_after_s=1.0)

    with pytest.raises(WorkersBusy, match="no room"):
        await answered(world, asked(world, room=no_room))
    assert kept(tmp_path) == []


async def test_a_mesh_that_nobody_waits_for_any_more_is_neither_made_nor_kept(world, tmp_path):
    await described(world, a=1)
    left = asked(world)
    lease = await some_job(world)
    left.cancel()
    with pytest.raises(asyncio.CancelledError):
        await left
    async with asyncio.timeout(PATIENCE_S):
        while await jobs_of(world):
            await asyncio.sleep(0.005)
    world.worker().run(lease)
    assert kept(tmp_path) == [] and await jobs_of(world) == []


async def test_a_mesh_made_just_before_its_asker_left_is_not_kept(world, tmp_path):
    await described(world, a=1)
    left = asked(world)
    world.worker().run(await some_job(world))
    left.cancel()
    await asyncio.gather(left, return_exceptions=True)
    await nothing_left(tmp_path)


async def test_a_mesh_that_no_worker_makes_in_time_is_no_answer(world, monkeypatch):
    monkeypatch.setattr("revisit.service.domain.limits.TILE_WAIT_S", 0.05)
    await described(world, a=1)
    with pytest.raises(NoAnswer):
        await asked(world)
    assert await jobs_of(world) == []


async def test_a_mesh_of_a_damaged_neural_map_or_of_a_deleted_submap_is_refused(world, tmp_path):
    await described(world, a=1)
    asking = asked(world)
    lease = await some_job(world)
    await world.use_cases.submaps.delete(TENANT, A)
    world.worker().run(lease)
    with pytest.raises(RevisitError) as refused:
        await asking
    assert refused.value.code == ErrorCode.NOT_FOUND
    await world.use_cases.posting.post(TENANT, submap("a", 2))
    world.work_off()
    for path in kept(tmp_path, "neural-map"):
        path.write_bytes(b"damaged")
    with pytest.raises(RevisitError) as refused:
        await answered(world, asked(world))
    assert refused.value.code == ErrorCode.DATA_LOSS


async def test_meshes_are_charged_what_they_cost_a_worker(world):
    await described(world, a=1)
    await answered(world, asked(world))
    world.context.in_flight.charge_call(TENANT, int(1e9))
    with pytest.raises(RateLimited):
        await asked(world)


async def test_a_mesh_is_not_begun_while_the_disk_is_full(world, monkeypatch):
    await described(world, a=1)
    monkeypatch.setattr(UnlimitedDisk, "full", lambda _: True)
    with pytest.raises(StorageFull):
        await asked(world)


async def test_meshes_that_an_earlier_version_stored_are_swept(world, tmp_path):
    await described(world, a=1)
    world.context.blobs.put(TENANT, MESH_BLOB, b"RVM1 of an earlier version")
    for path in kept(tmp_path):
        os.utime(path, (time.time() - 2 * UNREFERENCED_S,) * 2)
    assert await sweep(world.context.storage) == 1
    world.clock.ms += int(UNREFERENCED_S * 1000)
    assert await collect(world.context.storage) == 1 and kept(tmp_path) == []
