"""The index is loaded before the service is ready; whatever happens to it in memory is found and mended."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.index import FaissIndex, IndexEntry
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.index import caught_up_index
from revisit.service.features.index import keeping as index_keeping
from revisit.service.use_cases import UseCases
from tests.support.campaigns import Campaign, sizes
from tests.support.own_index import memory_over
from tests.support.records import anywhere
from tests.support.service_world import SESSION, TENANT, described_home, sqlite_world

SUBMAPS = 12


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """The data of a service with submaps."""
    return described_home(tmp_path_factory.mktemp("filled"), SUBMAPS)


@pytest.fixture
def context(tmp_path, filled):
    """A filled database, and an index that has not seen it yet."""
    world = sqlite_world(shutil.copytree(filled, tmp_path, dirs_exist_ok=True))
    yield replace(world.context, index=PlaceVectorIndex(FaissIndex))
    world.context.transactions.close()


@pytest.fixture
async def keeper(context):
    """It has loaded the index."""
    made = context.index_keeper()
    await made.load()
    return made


def map_of(context):
    return context.transactions.read(lambda uow: uow.maps.get(TENANT, SESSION.map_id)).result()


def found(context) -> list[str]:
    """The submaps that a search for each finds first."""
    memory, record = memory_over(context.transactions, context.index), map_of(context)
    rows = context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id=SESSION.map_id)).result()
    vectors = [np.frombuffer(row.descriptor, dtype="<f4") for row in rows]
    return [memory.recall(record, vector, 1, anywhere).places[0].submap.submap_id for vector in vectors]


EVERY_ONE = [f"s{number}" for number in range(SUBMAPS)]


async def test_the_service_is_ready_once_the_index_is_loaded(context):
    system = UseCases.over(context, "test").system
    assert (await system.readiness()).ready
    keeper = context.index_keeper()
    assert (await system.readiness()).reasons == ("the index is being loaded",)
    assert await keeper.audit() == 0
    await keeper.load()
    assert (await system.readiness()).ready
    assert context.index.size(map_of(context).number) == SUBMAPS


async def test_a_sound_index_has_no_drift(context, keeper):
    assert [await keeper.audit() for _ in range(3)] == [0, 0, 0]
    assert found(context) == EVERY_ONE


async def test_what_changes_while_the_audit_looks_is_no_drift(context, keeper, monkeypatch):
    use_cases = UseCases.over(context, "test")
    look = context.index.numbers

    def deleted_meanwhile(number):
        seen = look(number)
        rows = context.transactions.write(lambda uow: forget(uow, "s4")).result()
        assert rows == 1
        return seen

    def forget(uow, submap_id):
        record = uow.submaps.get(TENANT, SESSION.map_id, SESSION.session_id, submap_id)
        for end in ("query_number", "match_number"):
            uow.loops.delete(TENANT, **{end: record.number})
        uow.changes.record_removed(map_of(context), [record.number])
        return uow.submaps.delete(TENANT, number=record.number)

    monkeypatch.setattr(context.index, "numbers", deleted_meanwhile)
    assert await keeper.audit() == 0
    assert (await use_cases.system.readiness()).ready


async def test_a_map_that_is_deleted_is_no_drift(context, keeper):
    await UseCases.over(context, "test").maps.delete(TENANT, SESSION.map_id)
    assert await keeper.audit() == 0
    assert context.index_health.drift == 0


async def test_a_window_at_a_time_every_descriptor_is_compared(context, keeper, monkeypatch):
    monkeypatch.setattr(index_keeping, "WINDOW", 5)
    damage_vector(inner(context), np.random.default_rng(0), row=SUBMAPS - 1)
    assert [await keeper.audit() for _ in range(4)] == [0, 0, 1, 0]
    assert found(context) == EVERY_ONE


async def test_a_few_maps_at_a_time_each_gets_its_turn(context, keeper, monkeypatch):
    monkeypatch.setattr(index_keeping, "MAPS", 2)
    for number in range(4):
        await UseCases.over(context, "test").maps.create(TENANT, CreateMap(f"map{number}"))
    seen, look = [], keeper._audit_map
    monkeypatch.setattr(keeper, "_audit_map", lambda record: (seen.append(record.map_id), look(record))[1])
    for _ in range(4):
        assert await keeper.audit() == 0
    assert seen == ["town", "map0", "map1", "map2", "map3", "town", "map0"]


def inner(context) -> FaissIndex:
    """The innermost structure of the map's index."""
    return context.index._maps[map_of(context).number].entries


def flip_a_bit(vectors, rng, row) -> None:
    """Change one bit of one vector."""
    row = rng.integers(len(vectors)) if row is None else row
    held = vectors.view(np.uint8)
    held[row, rng.integers(held.shape[1])] ^= np.uint8(1 << rng.integers(8))


def damage_vector(places, rng, row=None) -> None:
    (block,) = places._rows.vectors._blocks
    flip_a_bit(block[: places._rows.count], rng, row)


def damage_what_is_compared(places, rng) -> None:
    places.ids()  # by now all are there
    flip_a_bit(places._flat._stored(), rng, None)


def lose_a_place(places, rng) -> None:
    places.remove([int(rng.choice(places.ids()))])


def hold_one_too_many(places, rng) -> None:
    number = 10**6 + int(rng.integers(9))
    places.add([IndexEntry(number, 0, number, np.zeros(3))], rng.normal(size=(1, 64)).astype(np.float32))


def forget_that_it_lives(places, rng) -> None:
    places._rows.alive[rng.integers(places._rows.count)] = False


def move_a_place(places, rng) -> None:
    places._rows.positions[rng.integers(places._rows.count), rng.integers(3)] += 1e-9


def change_a_session(places, rng) -> None:
    places._rows.sessions[rng.integers(places._rows.count)] += 1


DAMAGES = [
    damage_vector,
    damage_what_is_compared,
    lose_a_place,
    hold_one_too_many,
    forget_that_it_lives,
    move_a_place,
    change_a_session,
]


@pytest.mark.parametrize("damage", DAMAGES)
async def test_damage_to_the_index_is_found_counted_and_mended(context, keeper, damage):
    damage(inner(context), np.random.default_rng(7))
    assert await keeper.audit() == 1
    assert context.index_health.drift == 1
    assert found(context) == EVERY_ONE
    assert await keeper.audit() == 0


async def test_an_index_that_missed_changes_is_found_and_mended(context, keeper):
    number = map_of(context).number
    seq, _ = context.index.numbers(number)
    context.index.drop(number)
    context.index._of(number).seq = seq
    assert await keeper.audit() == SUBMAPS
    assert found(context) == EVERY_ONE


@pytest.mark.parametrize("mutations", sizes("INDEX_MUTATIONS", 100, 500))
async def test_hundreds_of_random_damages_are_each_found(context, keeper, mutations):
    rng, campaign = np.random.default_rng(2026), Campaign("P5", mutations)
    for turn in campaign:
        damage = DAMAGES[int(rng.integers(len(DAMAGES)))]
        damage(inner(context), rng)
        assert await keeper.audit() == 1, (turn, damage.__name__)
        if turn % 20 == 0:
            assert found(context) == EVERY_ONE, (turn, damage.__name__)
    campaign.publish(
        f"{campaign.done} of {campaign.done} damages of the index in memory found and mended, 0 wrong results"
    )


async def test_a_search_waits_for_a_map_that_is_forgotten_between_its_steps(context, keeper, monkeypatch):
    monkeypatch.setattr(caught_up_index, "PORTION", 5)
    search, forgotten = context.index.search, []

    def forgets_first(number, *arguments):
        if not forgotten:
            forgotten.append(number)
            context.index.drop(number)
        return search(number, *arguments)

    monkeypatch.setattr(context.index, "search", forgets_first)
    assert found(context) == EVERY_ONE
