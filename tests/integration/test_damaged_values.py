"""A row that cannot be read is DATA_LOSS to its readers, and stands in nobody else's way."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from revisit.core.errors import DataLoss
from revisit.core.index import FaissIndex
from revisit.core.radio import RadioFingerprint
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.retention import DAY_NS
from revisit.service.domain.states import OperationState, SubmapState
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.graph.anchor_verdicts import anchor_verdicts
from revisit.service.features.graph.session_poses import PackedSubmaps, unpack_loops
from revisit.service.features.index import keeping
from revisit.service.features.index.keeping import IndexHealth
from revisit.service.features.operations.claiming import JobClaims
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.retention import run as retention_run
from revisit.service.features.webhooks.calls import CreateWebhook
from tests.support.records import a_loop, a_map, a_session, a_submap
from tests.support.retained import driven, policy_set, stored_seqs
from tests.support.service_world import SESSION, TENANT, World, open_session, sqlite_world, submap
from tests.support.stored_rows import run

DATABASE = "revisit.db"

NO_TEXT = "{} = CAST(x'ff' AS TEXT)"
"""One flipped bit in eight of a text makes it none."""


@pytest.fixture
def world(tmp_path):
    made = sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


def claims(world: World) -> JobClaims:
    context = world.context
    return JobClaims(context.transactions, context.disk, context.blob_outage, "w1")


@pytest.mark.parametrize(
    "damage", ["payload = substr(payload, 2)", "subject = CAST(subject AS BLOB)", NO_TEXT.format("subject")]
)
async def test_a_damaged_job_fails_with_its_submap_and_the_next_one_runs(world, tmp_path, damage):
    await open_session(world)
    first = await world.use_cases.posting.post(TENANT, submap("a", 1))
    second = await world.use_cases.posting.post(TENANT, submap("b", 2))
    run(tmp_path / DATABASE, f"UPDATE jobs SET {damage} WHERE number = 1")
    lease = claims(world).next()
    assert lease is not None and lease.job.operation_id == second.operation.operation_id
    world.worker().run(lease)
    states = {one.submap_id: one.state for one in await listed(world)}
    assert states["b"] == SubmapState.DESCRIBED
    if damage.startswith("payload"):
        ended = await world.use_cases.operations.get(TENANT, first.operation.operation_id)
        assert (ended.state, ended.failure_code) == (OperationState.FAILED, "DATA_LOSS")
        assert states["a"] == SubmapState.FAILED
    else:
        with pytest.raises(DataLoss, match=r"row 1 of jobs is damaged: subject|Could not decode"):
            await world.use_cases.operations.get(TENANT, first.operation.operation_id)


MEASURED = {"measurement": {"score": 0.9, "covariance": np.eye(6).tolist(), "T_match_query": np.eye(4).tolist()}}
"""Evidence that is packed."""


@pytest.mark.parametrize(
    ("evidence", "change"),
    [
        (MEASURED, "evidence = CAST(x'0301' || substr(evidence, 3) AS BLOB)"),
        (MEASURED, "evidence = substr(evidence, 1, 60)"),
        (MEASURED, "evidence = x'03'"),
        (MEASURED, "evidence = x''"),
        ({"inliers": 12}, "evidence = substr(evidence, 2)"),
        ({"inliers": 12}, "evidence = x'31'"),
        ({"inliers": 12}, "evidence = x'01ff'"),
        ({"inliers": 12}, "evidence = x'ff'"),
        ({"inliers": 12}, "T_match_query = substr(T_match_query, 2)"),
        ({"inliers": 12}, "T_match_query = substr(T_match_query, 1, 50)"),
        ({"inliers": 12}, "state = CAST(state AS BLOB)"),
        ({"inliers": 12}, "reason = CAST(x'ff' AS TEXT)"),
        ({"inliers": 12}, "created_at_ns = 1.5"),
        ({"inliers": 12}, "similarity = 'x'"),
    ],
)
def test_a_damaged_row_of_a_pair_is_data_loss(world, tmp_path, evidence, change):
    store = world.context.transactions
    store.write(lambda uow: add_pair(uow, evidence)).result()
    assert store.read(lambda uow: uow.loops.find(TENANT)).result()[0].evidence == evidence
    run(tmp_path / DATABASE, f"UPDATE loop_closures SET {change}")
    with pytest.raises(DataLoss):
        store.read(lambda uow: uow.loops.find(TENANT)).result()


@pytest.mark.parametrize("change", ["evidence = x'03'", "evidence = x'7b'", "evidence = x'03010203'"])
def test_a_damaged_row_of_a_pair_is_data_loss_to_a_pose_graph(world, tmp_path, change):
    store = world.context.transactions
    store.write(lambda uow: add_pair(uow, MEASURED)).result()
    run(tmp_path / DATABASE, f"UPDATE loop_closures SET {change}")
    with pytest.raises(DataLoss):
        store.read(lambda uow: uow.loops.measured(TENANT, "town", after=0, limit=9)).result()


def test_a_damaged_list_is_data_loss(world, tmp_path):
    store = world.context.transactions
    store.write(lambda uow: uow.maps.add(replace(a_map(), origin=(48.0, 11.0, 500.0)))).result()
    run(tmp_path / DATABASE, "UPDATE maps SET origin = substr(origin, 2)")
    with pytest.raises(DataLoss):
        store.read(lambda uow: uow.maps.find(TENANT)).result()


@pytest.mark.parametrize(
    ("change", "read"),
    [
        ("UPDATE maps SET profile = 'rroduct'", lambda uow: uow.maps.find(TENANT)),
        ("UPDATE submaps SET flags = 'x'", lambda uow: uow.submaps.flag_counts(TENANT, "town", "monday")),
    ],
)
def test_a_damaged_word_is_data_loss(world, tmp_path, change, read):
    store = world.context.transactions
    store.write(lambda uow: add_pair(uow, {})).result()
    run(tmp_path / DATABASE, change)
    with pytest.raises(DataLoss):
        store.read(read).result()


@pytest.mark.parametrize(
    "read",
    [
        lambda: PackedSubmaps.of(bytes(279)),
        lambda: unpack_loops(bytes(16)),
        lambda: unpack_loops(bytes(8) + b"\x09" + bytes(8)),
        lambda: anchor_verdicts(bytes(3)),
        lambda: RadioFingerprint.of_bytes(bytes(10)),
    ],
)
def test_damaged_rows_of_numbers_are_data_loss(read):
    with pytest.raises(DataLoss):
        read()


def add_pair(uow, evidence) -> None:
    uow.maps.add(a_map())
    uow.sessions.add(a_session("monday"))
    numbers = [uow.submaps.add(a_submap(one)).number for one in ("a", "b")]
    uow.loops.add(replace(a_loop(*numbers), evidence=evidence))


async def listed(world: World):
    return (await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items


@pytest.mark.parametrize("damage", ["profile = CAST(profile AS BLOB)", NO_TEXT.format("display_name")])
@pytest.mark.parametrize("limit", [None, 1])
def test_what_is_done_for_all_tenants_goes_on_beside_a_damaged_map(world, tmp_path, limit, damage):
    store = world.context.transactions
    for map_id in ("one", "two", "three"):
        store.write(lambda uow, map_id=map_id: uow.maps.add(replace(a_map(), map_id=map_id))).result()
    run(tmp_path / DATABASE, f"UPDATE maps SET {damage} WHERE map_id = 'two'")
    run(tmp_path / DATABASE, "UPDATE maps SET origin = '[' WHERE map_id = 'one'")
    found = store.read(lambda uow: uow.maps.of_all_tenants(limit=limit)).result()
    assert [record.map_id for record in found] == ["three"]
    assert not store.read(lambda uow: uow.maps.of_all_tenants(after=found[-1].number, limit=limit)).result()


def test_whoever_reads_after_a_read_that_met_damage_reads_what_was_written_since(world, tmp_path):
    store = world.context.transactions
    store.write(lambda uow: add_pair(uow, {})).result()
    run(tmp_path / DATABASE, "UPDATE submaps SET position_m = 'x'")
    with pytest.raises(DataLoss) as met:
        store.read_here(lambda uow: uow.submaps.find(TENANT))
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_id="later"))).result()
    assert "later" in {one.map_id for one in store.read_here(every_map)}
    assert met.value  # whoever holds the error holds no snapshot


def test_whoever_writes_after_a_write_that_met_damage_is_not_held_up_by_it(world, tmp_path):
    store = world.context.transactions
    store.write(lambda uow: add_pair(uow, {})).result()
    run(tmp_path / DATABASE, "UPDATE submaps SET position_m = 'x'")
    with pytest.raises(DataLoss) as met:
        store.write(lambda uow: uow.submaps.find(TENANT)).result()
    run(tmp_path / DATABASE, "UPDATE maps SET display_name = 'by another process'")
    store.write(lambda uow: uow.maps.add(replace(a_map(), map_id="later"))).result()
    assert {one.display_name for one in store.read_here(every_map)} == {"by another process", a_map().display_name}
    assert met.value


def test_a_change_of_a_row_with_a_damaged_text_is_data_loss(world, tmp_path):
    store = world.context.transactions
    store.write(lambda uow: uow.maps.add(a_map())).result()
    (record,) = store.read(lambda uow: uow.maps.find(TENANT)).result()
    run(tmp_path / DATABASE, f"UPDATE maps SET {NO_TEXT.format('display_name')}")
    with pytest.raises(DataLoss):
        store.write(lambda uow: uow.maps.revise([record], index_file="x")).result()


@pytest.mark.parametrize("damage", ["kinds = 'x'", NO_TEXT.format("url")])
async def test_webhooks_of_others_are_told_beside_a_damaged_one(world, tmp_path, damage):
    await open_session(world)
    for webhook_id in ("first", "second"):
        await world.use_cases.webhooks.create(TENANT, CreateWebhook(webhook_id, "https://example.org/x"))
    await world.use_cases.posting.post(TENANT, submap("a", 1))
    world.work_off()
    due = partial(world.context.transactions.read, lambda uow: uow.webhooks.due(2**62))
    assert [one.webhook_id for one in due().result()] == ["first", "second"]
    run(tmp_path / DATABASE, f"UPDATE webhooks SET {damage} WHERE webhook_id = 'first'")
    assert [one.webhook_id for one in due().result()] == ["second"]


@pytest.mark.parametrize("damage", ["flags", "described_at_ns"])
async def test_retention_goes_on_beside_a_damaged_map(world, tmp_path, damage):
    for map_id in ("one", "two"):
        await driven(world, 20, SessionKey(map_id, "monday"))
        await policy_set(world, "scans=none", map_id)
    run(tmp_path / DATABASE, f"UPDATE submaps SET {damage} = 'x' WHERE map_id = 'one'")
    await world.context.retention.all()
    assert stored_seqs(world, SessionKey("two", "monday")) == []
    assert stored_seqs(world, SessionKey("one", "monday")) != []


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE maps SET retention = 'scans=14h' WHERE map_id = 'one'",
        "UPDATE maps SET retention = 'scans=y4h' WHERE map_id = 'one'",
        "UPDATE sessions SET finished_at_ns = finished_at_ns + 1 WHERE map_id = 'one'",
    ],
)
async def test_retention_removes_nothing_by_a_damaged_policy_and_goes_on_with_others(world, tmp_path, change):
    for map_id in ("one", "two"):
        await driven(world, 20, SessionKey(map_id, "monday"))
        await policy_set(world, "scans=24h", map_id)
    run(tmp_path / DATABASE, change)
    in_two_days_ns = world.context.clock.wall_ns() + 2 * DAY_NS
    await world.context.retention.all(in_two_days_ns)
    assert stored_seqs(world, SessionKey("two", "monday")) == []
    assert stored_seqs(world, SessionKey("one", "monday")) != []


async def test_a_damaged_policy_is_data_loss_to_who_asks_for_it(world, tmp_path):
    await open_session(world)
    await policy_set(world, "scans=24h")
    run(tmp_path / DATABASE, "UPDATE maps SET retention = 'scans=y4h'")
    with pytest.raises(DataLoss):
        await world.use_cases.retention.get(TENANT, SESSION.map_id)


async def test_retention_reaches_the_maps_behind_a_damaged_one(world, tmp_path, monkeypatch):
    await driven(world, 20, SessionKey("one", "monday"))
    for map_id in ("two", "three"):
        await driven(world, 20, SessionKey(map_id, "monday"))
        await policy_set(world, "scans=none", map_id)
    run(tmp_path / DATABASE, "UPDATE maps SET profile = CAST(profile AS BLOB) WHERE map_id = 'one'")
    monkeypatch.setattr(retention_run, "MAPS_A_PAGE", 2)
    await world.context.retention.all()
    assert [stored_seqs(world, SessionKey(map_id, "monday")) for map_id in ("two", "three")] == [[], []]


async def described_in(world, *maps):
    """A submap in each of the maps."""
    for map_id in maps:
        await open_session(world, SessionKey(map_id, "monday"))
        await world.use_cases.posting.post(TENANT, submap("a", 1, SessionKey(map_id, "monday")))
    world.work_off()


async def test_an_audit_reaches_the_maps_behind_damaged_ones(world, tmp_path, monkeypatch):
    await described_in(world, "one", "two", "three")
    index = PlaceVectorIndex(FaissIndex)
    keeper = replace(world.context, index=index).index_keeper()
    await keeper.load()
    run(tmp_path / DATABASE, "UPDATE maps SET profile = CAST(profile AS BLOB) WHERE map_id = 'one'")
    run(tmp_path / DATABASE, "UPDATE submaps SET position_m = 'x' WHERE map_id = 'two'")
    monkeypatch.setattr(keeping, "MAPS", 2)
    number = world.context.transactions.read(lambda uow: uow.maps.get(TENANT, "three")).result().number
    for _ in range(2):
        lose_all(index, number)
        assert sum([await keeper.audit() for _ in range(2)]) == 1


def lose_all(index: PlaceVectorIndex, map_number: int) -> None:
    """Drift: the index holds nothing of a map, and takes itself for up to date."""
    seq, _ = index.numbers(map_number)
    index.drop(map_number)
    index._of(map_number).seq = seq


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE submaps SET position_m = 'x' WHERE map_id = 'one'",
        "UPDATE submaps SET ordinal = 'x' WHERE map_id = 'one'",
        "UPDATE submaps SET descriptor = 'x' WHERE map_id = 'one'",
        "UPDATE index_changes SET seq = 'x' WHERE map_number = (SELECT number FROM maps WHERE map_id = 'one')",
    ],
)
async def test_a_service_starts_beside_a_damaged_map(world, tmp_path, damage):
    await described_in(world, "one", "two")
    run(tmp_path / DATABASE, damage)
    index, health = PlaceVectorIndex(FaissIndex), IndexHealth()
    await replace(world.context, index=index, index_health=health).index_keeper().load()
    numbers = {record.map_id: record.number for record in world.context.transactions.read(every_map).result()}
    assert not health.loading
    assert (index.size(numbers["one"]), index.size(numbers["two"])) == (0, 1)


def every_map(uow):
    return uow.maps.find(TENANT)


async def test_a_job_whose_submap_is_damaged_ends_and_keeps_nobody_from_theirs(world, tmp_path):
    await open_session(world)
    first = await world.use_cases.posting.post(TENANT, submap("a", 1))
    run(tmp_path / DATABASE, "UPDATE submaps SET position_m = 'x' WHERE submap_id = 'a'")
    lease = claims(world).next()
    assert lease is not None
    world.worker().run(lease)
    ended = await world.use_cases.operations.get(TENANT, first.operation.operation_id)
    assert (ended.state, ended.failure_code) == (OperationState.FAILED, "DATA_LOSS")
    assert claims(world).next() is None
