"""Neural maps of retired submaps go where a later drive shows their place; surfaces, files and reviews have theirs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest

from revisit.service.domain.errors import NotKept
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.records import MapMergeRecord
from revisit.service.domain.retention import RetentionRule, parsed
from revisit.service.domain.states import SubmapState
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.graph.released_maps import released_maps
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.retention.rules import PlacedView, last_views
from revisit.service.ports.blobs import NEURAL_MAP_BLOB
from revisit.service.ports.map_tiles import Moment
from tests.support.retained import DAY_MS, cut_off_and_finished, last_run, policy_set, retained
from tests.support.service_world import (
    SESSION,
    TENANT,
    answered,
    memory_world,
    open_session,
    postgres_world,
    scan,
    sqlite_world,
)
from tests.support.stored_rows import run

SCANS = 30
TUESDAY = SessionKey("town", "tuesday")
RELEASED = "best=1,retired=1d"
A_DAY_NS = 86_400_000_000_000


@pytest.fixture
def world():
    return memory_world()


@pytest.fixture(params=[sqlite_world, postgres_world], ids=["sqlite", "postgres"])
def stored_world(request, tmp_path):
    made = request.param(tmp_path) if request.param is sqlite_world else request.param()
    yield made
    made.context.transactions.close()


async def twice_driven(world) -> None:
    """Two drives over the same places, in one frame of the map, two days ago."""
    for day, session in enumerate((SESSION, TUESDAY)):
        await open_session(world, session)
        for seq in range(1, SCANS + 1):
            one = scan(seq, float(seq), session)
            await world.use_cases.scans.append(TENANT, replace(one, stamp_ns=one.stamp_ns + day * A_DAY_NS))
        await world.use_cases.sessions.finish(TENANT, session)
        world.work_off()
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    world.clock.ms += 2 * DAY_MS


def rows_of(world) -> dict[int, object]:
    read = world.context.transactions.read
    return {row.number: row for row in read(lambda uow: uow.submaps.find(TENANT, map_id="town")).result()}


def released(world) -> frozenset[int]:
    return world.context.transactions.read(partial(released_maps, tenant=TENANT, map_id="town")).result()


def poses(world) -> list[tuple[int, bytes]]:
    rows = world.context.transactions.read(lambda uow: uow.session_poses.find(TENANT, map_id="town")).result()
    return [(row.session_number, row.submaps) for row in rows]


def view(number: int, x_m: float, day: int, frame: str = "a", storey: str | None = None) -> PlacedView:
    return PlacedView(number, frame, storey, (x_m, 0.0, 0.0), (day, 0, 0))


def test_the_last_view_of_each_square_is_the_newest():
    drives = [view(10 * day + place, 5.0 * place + 0.5 * day, day) for day in (1, 2, 3) for place in range(4)]
    assert last_views(drives, 5.0) == {30, 31, 32, 33}
    assert last_views([*drives[:8], view(90, 1.0, 0), view(91, -1.0, 0)], 5.0) == {20, 21, 22, 23, 91}


def test_another_frame_or_storey_is_another_place():
    assert last_views([view(1, 0.0, 1), view(2, 0.0, 2, "b"), view(3, 0.0, 3, storey="B2")], 5.0) == {1, 2, 3}


async def test_retired_submaps_whose_place_a_later_one_shows_lose_their_neural_maps(stored_world):
    world = stored_world
    await twice_driven(world)
    before, dry = poses(world), await world.use_cases.retention.preview(TENANT, "town", parsed(RELEASED))
    report = await retained(world, RELEASED)
    outcome = {one.rule: one for one in report.rules}[RetentionRule.RETIRED_MAPS]
    gone, rows = released(world), rows_of(world)
    assert outcome.submaps == len(gone) > 0 and {row.state for row in rows.values()} == {"DESCRIBED", "RETIRED"}
    assert {one.rule: one.counts() for one in dry.rules} == {one.rule: one.counts() for one in report.rules}
    assert {rows[one].session_id for one in gone} == {SESSION.session_id}, "Tuesday shows all places later"
    assert poses(world) == before and await retained(world) == report


async def test_a_dry_run_of_all_rules_tells_what_a_run_removes(world):
    await twice_driven(world)
    policy = "sessions=1d,retired=1d,scans=none"
    dry, report = await world.use_cases.retention.preview(TENANT, "town", parsed(policy)), await retained(world, policy)
    assert report.rules == dry.rules and {one.rule for one in report.rules} >= {"SESSIONS", "RETIRED_MAPS"}


async def test_a_retired_submap_keeps_its_neural_map_until_its_days_are_over(world):
    await twice_driven(world)
    await retained(world, "best=1,retired=3d")
    assert released(world) == frozenset() and SubmapState.RETIRED in {row.state for row in rows_of(world).values()}
    world.clock.ms += DAY_MS
    assert len((await retained(world)).rules) == 1 and released(world)


async def test_a_place_keeps_the_last_view_of_before_its_days(world):
    await twice_driven(world)
    sessions = world.context.transactions.read(lambda uow: uow.sessions.find(TENANT, map_id="town")).result()
    young = replace(sessions[1], finished_at_ns=sessions[1].finished_at_ns + 2 * A_DAY_NS)
    world.context.transactions.write(lambda uow: uow.sessions.replace(young)).result()
    await retained(world, RELEASED)
    assert released(world) == frozenset(), "Monday's is the last view of a place as of yesterday"


async def test_a_view_that_goes_with_a_merge_taken_back_is_not_the_last(world):
    await twice_driven(world)
    write, merge = world.context.transactions.write, ("m1", "maps/other", 0, 1, (TUESDAY.session_id,), {}, 1)
    merged = write(lambda uow: uow.map_merges.add(MapMergeRecord(TENANT, "town", *merge))).result()
    await retained(world, RELEASED)
    assert released(world) == frozenset(), "without Tuesday, Monday's view is the last"
    write(lambda uow: uow.map_merges.replace(replace(merged, reverted_at_ns=2))).result()
    await retained(world)
    assert released(world)


async def test_a_submap_without_its_neural_map_says_so(world):
    await twice_driven(world)
    await retained(world, RELEASED)
    key = rows_of(world)[min(released(world))].key
    shown = await world.use_cases.submaps.get(TENANT, key)
    assert shown.state == SubmapState.RETIRED and shown.neural_map_bytes is None
    for kind in (DownloadKind.NEURAL, DownloadKind.MESH):
        with pytest.raises(NotKept, match="neural map"):
            await answered(world, world.use_cases.submaps.download(TENANT, key, kind))


async def test_a_surface_of_a_day_of_which_no_view_is_left_is_refused_and_others_are_made(world):
    await twice_driven(world)
    version = (await world.use_cases.map_versions.list(TENANT, "town", PageRequest())).items[-1].version
    tile = (await world.use_cases.map_tiles.list(TENANT, "town", version, PageRequest())).items[0].key
    await retained(world, RELEASED)
    gone = max(rows_of(world)[one].stamp_ns for one in released(world))
    last = max(row.stamp_ns for row in rows_of(world).values())
    ask = partial(world.use_cases.map_tiles.download, TENANT, kind=DownloadKind.NEURAL)
    with pytest.raises(NotKept, match="of that moment"):
        await answered(world, ask(replace(tile, moment=Moment(as_of_ns=gone))))
    for moment in (Moment(), Moment(ever=True), Moment(as_of_ns=last)):
        assert (await answered(world, ask(replace(tile, moment=moment)))).data
    monday = {row.session_number for row in rows_of(world).values() if row.session_id == SESSION.session_id}
    assert world.tiler.drives and not any(monday & drives for drives in world.tiler.drives)


async def test_a_published_file_keeps_the_neural_maps_that_it_names(world):
    await twice_driven(world)
    await world.use_cases.map_files.publish(TENANT, "town", 1)
    world.work_off()
    file = await world.use_cases.map_files.open(TENANT, "town", 1)
    report = await retained(world, RELEASED)
    assert RetentionRule.RETIRED_MAPS not in {one.rule for one in report.rules}
    assert sum([len(piece) async for piece in file.pieces(0, file.layout.size)]) == file.layout.size


async def test_what_a_proposal_names_keeps_its_neural_map(world):
    await twice_driven(world)
    await retained(world, "best=1")
    retired_ones = {row.number for row in rows_of(world).values() if row.state == SubmapState.RETIRED}
    loops = world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id="town")).result()
    loop = next(one for one in loops if {one.query_number, one.match_number} & retired_ones)
    proposed = replace(loop, state="PROPOSED")
    world.context.transactions.write(lambda uow: uow.loops.replace(proposed)).result()
    report = await retained(world, RELEASED)
    assert not {loop.query_number, loop.match_number} & released(world) and report.submaps_held > 0


@pytest.mark.parametrize("point", ["commit.before", "commit.after", "delete.after_rows"])
async def test_a_release_that_was_cut_off_is_finished_by_the_next_process(tmp_path, point):
    world = sqlite_world(tmp_path)
    await twice_driven(world)
    await retained(world, "best=1")
    await policy_set(world, RELEASED)
    await cut_off_and_finished(world, f"{point}=raise@1")
    named = {row.neural_map_sha256 for row in rows_of(world).values()} - {None}
    stored = {one.sha256 for one in world.context.blobs.stored(0.0) if one.kind == NEURAL_MAP_BLOB}
    assert released(world) and stored == named and await last_run(world)
    assert run(tmp_path / "revisit.db", "PRAGMA foreign_key_check") == []
    world.context.transactions.close()
