"""A map of an older model is described again from its neural maps, all at once, and an interrupted run goes on."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.codec import neural_map as codec
from revisit.core.errors import DegenerateCloud
from revisit.core.index import FaissIndex
from revisit.service.domain.identity import SubmapKey
from revisit.service.engines.local.files.file_drafts import FileDrafts
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.recognition.reembedding import Reembedding
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, PLACE_BLOB, StoredBlob
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.own_index import memory_over
from tests.support.records import anywhere
from tests.support.service_world import SESSION, TENANT, open_session, sqlite_world, submap

IDS = ("a", "b", "c")


class Newer(FakeRecogniser):
    """Another model, which counts what it describes."""

    model_version = "fake-2"

    def __init__(self) -> None:
        self.again = self.from_scans = 0
        self.places_before = []

    def describe_again(self, neural_map, place, config):
        self.again += 1
        self.places_before.append(place)
        return super().describe_again(neural_map, place, config)

    def describe(self, submap, config):
        self.from_scans += 1
        return super().describe(submap, config)


@pytest.fixture
async def world(tmp_path):
    """Three submaps of the model fake-1."""
    world = sqlite_world(tmp_path)
    await open_session(world)
    for number, submap_id in enumerate(IDS, 1):
        await world.use_cases.posting.post(TENANT, submap(submap_id, number))
    world.work_off()
    yield world
    world.context.transactions.close()


@pytest.fixture
def drafts(tmp_path):
    return FileDrafts(tmp_path / "reembedding")


def work_of(world, recogniser, drafts) -> Reembedding:
    return Reembedding(world.context.transactions, world.context.blobs, world.context.policy, recogniser, drafts)


def rows_of(world):
    return world.context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id=SESSION.map_id)).result()


def map_of(world):
    return world.context.transactions.read(lambda uow: uow.maps.get(TENANT, SESSION.map_id)).result()


async def test_every_submap_gets_the_new_model_and_is_found_by_it(world, drafts):
    memory = memory_over(world.context.transactions, PlaceVectorIndex(FaissIndex))
    before = rows_of(world)
    query = np.frombuffer(before[0].descriptor, "<f4")
    assert memory.recall(map_of(world), query, 1, anywhere).places[0].submap.submap_id == "a"
    newer, told = Newer(), []
    work = work_of(world, newer, drafts)
    (stale,) = work.stale_maps()
    done = work.reembed(stale, lambda n, total: told.append((n, total)))
    assert (done.submaps, done.from_scans, done.failures, told) == (3, 0, {}, [(1, 3), (2, 3), (3, 3)])
    assert work.stale_maps() == [] and map_of(world).model_version == "fake-2"
    assert newer.places_before == [world.context.blobs.get(TENANT, PLACE_BLOB, row.place_sha256) for row in before]
    for old, new in zip(before, rows_of(world), strict=True):
        assert new.descriptor == np.frombuffer(old.descriptor, "<f4")[::-1].tobytes()
        assert (new.model_version, new.neural_map_sha256) == ("fake-2", old.neural_map_sha256)
        assert world.context.blobs.get(TENANT, PLACE_BLOB, new.place_sha256) == new.descriptor
        found = memory.recall(map_of(world), np.frombuffer(new.descriptor, "<f4"), 1, anywhere)
        assert found.places[0].submap.submap_id == new.submap_id
    await world.use_cases.posting.post(TENANT, submap("d", 9))
    world.work_off(newer)
    assert [row.state for row in rows_of(world)] == ["DESCRIBED"] * 4


async def test_an_interrupted_run_changes_nothing_and_goes_on_where_it_ended(world, drafts):
    before = rows_of(world)

    def interrupt(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work_of(world, Newer(), drafts).reembed(map_of(world), interrupt)
    assert rows_of(world) == before and map_of(world).model_version == "fake-1"
    damaged = drafts._file(f"{map_of(world).number}-{before[0].number}-fake-2")
    damaged.write_bytes(damaged.read_bytes()[:-1])
    second = Newer()
    done = work_of(world, second, drafts).reembed(map_of(world))
    assert done.submaps == 3 and second.again == 2  # the one that was damaged, and the third
    assert not drafts._folder.exists()


async def test_a_submap_without_its_neural_map_is_described_from_its_scans(world, drafts):
    world.context.blobs.delete([StoredBlob(TENANT, NEURAL_MAP_BLOB, rows_of(world)[1].neural_map_sha256)])
    newer = Newer()
    done = work_of(world, newer, drafts).reembed(map_of(world))
    assert (done.from_scans, done.failures, newer.from_scans) == (1, {}, 1)


def former(world, row) -> str:
    """A blob of a former form of a neural map; its hash."""
    return world.context.blobs.put(TENANT, NEURAL_MAP_BLOB, b"RVNM\x02" + row.submap_id.encode())


async def test_neural_maps_of_a_former_form_are_made_anew_from_the_scans_of_a_named_map(world, drafts):
    def put_back(uow):
        for row in uow.submaps.find(TENANT, map_id=SESSION.map_id):
            uow.submaps.replace(replace(row, neural_map_sha256=former(world, row)))

    class Today(FakeRecogniser):
        def describe_again(self, neural_map, place, config):
            return super().describe_again(codec.unpack(neural_map), place, config)

    before = rows_of(world)
    world.context.transactions.write(put_back).result()
    work = work_of(world, Today(), drafts)
    assert work.stale_maps() == work.named_maps(["elsewhere"]) == []
    (named,) = work.named_maps([SESSION.map_id])
    done = work.reembed(named)
    assert (done.submaps, done.from_scans, done.failures) == (3, 3, {})
    assert [row.neural_map_sha256 for row in rows_of(world)] == [row.neural_map_sha256 for row in before]
    assert [row.descriptor for row in rows_of(world)] == [row.descriptor for row in before]


async def test_a_submap_whose_place_is_gone_is_described_from_its_neural_map_alone(world, drafts):
    world.context.blobs.delete([StoredBlob(TENANT, PLACE_BLOB, rows_of(world)[0].place_sha256)])
    newer = Newer()
    done = work_of(world, newer, drafts).reembed(map_of(world))
    assert (done.from_scans, done.failures) == (0, {})
    assert newer.places_before[0] is None and None not in newer.places_before[1:]


async def test_what_cannot_be_described_has_failed_with_the_reason_and_is_found_no_more(world, drafts):
    class Choosy(Newer):
        def describe_again(self, neural_map, place, config):
            raise DegenerateCloud("nothing to see")

        def describe(self, submap, config):
            if self.from_scans:
                raise DegenerateCloud("nothing to see in the scans")
            return super().describe(submap, config)

    done = work_of(world, Choosy(), drafts).reembed(map_of(world))
    assert done.failures == dict.fromkeys(("b", "c"), "nothing to see in the scans")
    assert [(row.state, row.failure_code) for row in rows_of(world)] == [
        ("DESCRIBED", None), ("FAILED", "UNUSABLE_CLOUD"), ("FAILED", "UNUSABLE_CLOUD"),
    ]  # fmt: skip
    memory = memory_over(world.context.transactions, PlaceVectorIndex(FaissIndex))
    query = np.frombuffer(rows_of(world)[0].descriptor, "<f4")
    found = memory.recall(map_of(world), query, 5, anywhere).places
    assert [place.submap.submap_id for place in found] == ["a"]


async def test_a_map_that_has_changed_meanwhile_is_looked_at_again(world, drafts):
    newer, posted = Newer(), []

    async def delete_one():
        await world.use_cases.submaps.delete(TENANT, SubmapKey("town", "monday", "b"))

    loop = asyncio.get_running_loop()

    def meanwhile(done, total):
        if done == 3 and not posted:
            posted.append(done)
            asyncio.run_coroutine_threadsafe(delete_one(), loop).result(30)

    done = await asyncio.to_thread(work_of(world, newer, drafts).reembed, map_of(world), meanwhile)
    assert done.submaps == 2 and newer.again == 3
    assert {row.model_version for row in rows_of(world)} == {"fake-2"}


def newer() -> Newer:
    """What a setting names."""
    return Newer()


def test_a_person_brings_a_map_to_the_installed_model_by_typing(tmp_path, monkeypatch):
    async def prepare():
        world = sqlite_world(tmp_path)
        await open_session(world)
        await world.use_cases.posting.post(TENANT, submap("a", 1))
        world.work_off()
        world.context.transactions.close()

    asyncio.run(prepare())
    monkeypatch.setenv("REVISIT_FOR_TESTS", json.dumps({"recogniser": f"{__name__}:newer"}))
    told = CliRunner().invoke(app, ["reembed", "--home", str(tmp_path), "--json"])
    assert told.exit_code == 0, told.output
    (done,) = json.loads(told.stdout)
    assert (done["map"], done["from"], done["to"], done["submaps"]) == ("town", "fake-1", "fake-2", 1)
    again = CliRunner().invoke(app, ["reembed", "--home", str(tmp_path)])
    assert again.exit_code == 0 and "every map is of the installed model" in again.output
