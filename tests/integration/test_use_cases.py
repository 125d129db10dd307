"""The use cases over both stores: what clients are promised, without transports or processes."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.errors import BadField, BadTransform, DataLoss, DescriptorModelMismatch, EmptyCloud, RevisitError
from revisit.core.geometry.se3 import pose_matrix
from revisit.service.domain.errors import (
    AlreadyExists,
    Draining,
    NotFound,
    NotReady,
    SequenceGap,
    SessionFinished,
    WorkersBusy,
)
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.loop_policy import LoopPolicy
from revisit.service.domain.states import LoopState, OperationState, SessionState, SubmapState
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.ingest.appending import ScanStream
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.search.calls import LocalizeQuery
from revisit.service.features.upkeep import sweeping
from revisit.service.features.upkeep.forgetting import forget_answers
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from revisit.service.ports.blobs import CLOUD_BLOB, QUERY_CLOUD_BLOB
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED, RAISES, FakeRecogniser
from tests.support.patience import PATIENCE_S
from tests.support.service_world import (
    SESSION,
    TENANT,
    answered,
    cloud,
    cloud_points,
    described,
    memory_world,
    open_session,
    pose,
    posted,
    scan,
    sqlite_world,
    submap,
)

OTHER = TenantId("other")


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


def key(submap_id: str, session: SessionKey = SESSION) -> SubmapKey:
    return SubmapKey(session.map_id, session.session_id, submap_id)


async def test_a_posted_submap_becomes_a_description_with_a_loop_to_the_same_place(world):
    await posted(world, a=1, b=2, c=3, again=1)
    assert world.work_off() == 4
    loops = await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.ACCEPTED)
    assert [(loop.query.submap_id, loop.match.submap_id) for loop in loops.items] == [("again", "a")]
    loop = await world.use_cases.loops.get(TENANT, "town", loops.items[0].loop_id)
    np.testing.assert_array_equal(pose_matrix(loop.T_match_query), pose(1.0))
    assert loop.evidence["model_version"] == "fake-1" and loop.evidence["measurement"]["overlap"] == pytest.approx(1.0)
    rejected = await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.REJECTED)
    assert all(loop.reason == "LOW_OVERLAP" and loop.T_match_query is None for loop in rejected.items)


async def test_a_posted_cloud_in_centimetres_is_flagged_before_it_is_described(world):
    await posted(world, metres=1)
    assert (await world.use_cases.submaps.get(TENANT, key("metres"))).flags == ()
    large = replace(cloud(2), points=cloud(2).points * np.float32(1000.0 / np.abs(cloud(2).points).max()))
    answer = await world.use_cases.posting.post(TENANT, replace(submap("centimetres", 2), cloud=large))
    assert answer.submap.flags == ("scene_too_large",)


async def test_a_place_just_left_is_no_candidate_and_one_left_and_entered_again_is(world):
    await described(world, a=1, b=1, c=2, d=1)
    loops = (await world.use_cases.loops.list(TENANT, "town", PageRequest())).items
    assert {(loop.query.submap_id, loop.match.submap_id) for loop in loops} == {("d", "a"), ("d", "b")}


async def test_a_finished_session_without_a_loop_says_why(world):
    await open_session(world)
    assert await why(world) is None  # it may get one yet
    assert (await world.use_cases.sessions.finish(TENANT, SESSION)).no_loops.code == "NO_SUBMAP"


async def test_a_drive_that_comes_back_to_no_place_says_so_until_another_drive_meets_it(world):
    await described(world, a=1, b=2, c=3)
    await world.use_cases.sessions.finish(TENANT, SESSION)
    told = await why(world)
    assert told.code == "NOTHING_TO_COMPARE"
    assert told.message == (
        "3 submaps: the drive came back to no place that it had left by 0.5 m (leave_distance_m), and the map has no "
        "other session to compare it with"
    )
    tuesday = SessionKey("town", "tuesday")
    await open_session(world, tuesday)
    await world.use_cases.posting.post(TENANT, submap("d", 7, tuesday))
    assert (await why(world)).code == "NOTHING_TO_COMPARE"
    world.work_off()
    told = await why(world)
    assert told.code == "NONE_ACCEPTED"
    assert told.message.startswith(
        "3 submaps: 3 pairs were compared and none was accepted, most often for LOW_OVERLAP (3)"
    )
    await world.use_cases.posting.post(TENANT, submap("e", 2, tuesday))
    world.work_off()
    assert await why(world) is None


async def why(world):
    return (await world.use_cases.sessions.get(TENANT, SESSION)).no_loops


async def test_a_repeated_post_gives_the_first_answer_and_another_content_is_refused(world):
    await open_session(world)
    first = await world.use_cases.posting.post(TENANT, submap("a", 1))
    world.work_off()
    again = await world.use_cases.posting.post(TENANT, submap("a", 1))
    assert (first.replay, again.replay) == (False, True)
    assert again.operation.operation_id == first.operation.operation_id
    assert again.submap.state == SubmapState.DESCRIBED
    with pytest.raises(AlreadyExists):
        await world.use_cases.posting.post(TENANT, submap("a", 2))
    with pytest.raises(AlreadyExists):
        await world.use_cases.posting.post(TENANT, replace(submap("a", 1), stamp_ns=5))


async def until_taken(world, posted):
    """Post as a client does: again with the same id while too many clouds are being taken in."""
    while True:
        try:
            return await world.use_cases.posting.post(TENANT, posted)
        except WorkersBusy:
            await asyncio.sleep(0.01)


async def test_fifty_concurrent_posts_of_one_submap_store_it_once(world):
    await open_session(world)
    answers = await asyncio.gather(*(until_taken(world, submap("a", 1)) for _ in range(50)))
    assert sum(not answer.replay for answer in answers) == 1
    assert len((await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items) == 1
    assert len((await world.use_cases.operations.list(TENANT, PageRequest())).items) == 1


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"key": key("../etc")}, BadField),
        ({"key": key("scans-1-2")}, BadField),
        ({"key": key("x" * 65)}, BadField),
        ({"cloud": cloud(1, points=99)}, EmptyCloud),
        ({"T_odom_submap": 2 * np.eye(4)}, BadTransform),
        ({"stamp_ns": -1}, BadField),
        ({"key": key("a", SessionKey("town", "nowhere"))}, NotFound),
        ({"key": key("a", SessionKey("nowhere", "monday"))}, NotFound),
    ],
)
async def test_a_bad_submap_is_refused_and_stores_nothing(world, change, error):
    await open_session(world)
    with pytest.raises(error):
        await world.use_cases.posting.post(TENANT, replace(submap("a", 1), **change))
    assert not (await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items
    assert not (await world.use_cases.operations.list(TENANT, PageRequest())).items


async def test_nothing_of_a_tenant_is_there_for_another(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))
    world.work_off()
    cases = world.use_cases
    calls = [
        cases.maps.get(OTHER, "town"),
        cases.maps.delete(OTHER, "town"),
        cases.sessions.get(OTHER, SESSION),
        cases.sessions.list(OTHER, "town", PageRequest()),
        cases.sessions.finish(OTHER, SESSION),
        cases.sessions.create(OTHER, CreateSession("town", "mine")),
        cases.submaps.get(OTHER, key("a")),
        cases.submaps.delete(OTHER, key("a")),
        cases.submaps.download(OTHER, key("a"), DownloadKind.POINTS),
        cases.posting.post(OTHER, submap("b", 1)),
        cases.scans.open(OTHER, SESSION),
        cases.scans.append(OTHER, scan(1, 0.0)),
        cases.searches.by_submap(OTHER, key("a"), SearchCriteria()),
        cases.searches.by_cloud(OTHER, "town", cloud(1), SearchCriteria()),
        cases.loops.list(OTHER, "town", PageRequest()),
        cases.operations.get(OTHER, posted.operation.operation_id),
    ]
    for call in calls:
        with pytest.raises(NotFound):
            await call
    assert not (await cases.maps.list(OTHER, PageRequest())).items
    assert (await cases.maps.get(TENANT, "town")).submap_count == 1


async def test_two_tenants_may_use_the_same_names_and_find_only_their_own(world):
    for tenant in (TENANT, OTHER):
        await open_session(world, tenant=tenant)
        await world.use_cases.posting.post(tenant, submap("a", 1))
    world.work_off()
    hits = await world.use_cases.searches.by_submap(OTHER, key("a"), SearchCriteria())
    assert (hits.hits, hits.searched) == ((), 1)
    assert not (await world.use_cases.loops.list(TENANT, "town", PageRequest())).items


async def test_a_search_sees_every_submap_described_before_it_and_none_deleted(world):
    await posted(world, a=1, b=2, c=1)
    with pytest.raises(NotReady):
        await world.use_cases.searches.by_submap(TENANT, key("a"), SearchCriteria())
    world.work_off()
    found = await world.use_cases.searches.by_submap(TENANT, key("a"), SearchCriteria(k=1))
    assert found.hits[0].submap == key("c") and found.hits[0].similarity == pytest.approx(1.0)
    assert found.searched == 3
    await world.use_cases.submaps.delete(TENANT, key("c"))
    found = await world.use_cases.searches.by_submap(TENANT, key("a"), SearchCriteria(min_similarity=0.9))
    assert (found.hits, found.searched) == ((), 2)


async def test_search_filters_narrow_the_hits(world):
    tuesday = SessionKey("town", "tuesday")
    await open_session(world)
    await open_session(world, tuesday)
    for session, submap_id, place in [(SESSION, "a", 1), (SESSION, "b", 1), (SESSION, "c", 1), (tuesday, "d", 1)]:
        await world.use_cases.posting.post(TENANT, submap(submap_id, place, session))
    world.work_off()

    async def ids(**criteria):
        found = await world.use_cases.searches.by_submap(TENANT, key("a"), SearchCriteria(**criteria))
        return [hit.submap.submap_id for hit in found.hits]

    assert await ids() == ["b", "c", "d"]
    assert await ids(exclude_session="monday") == ["d"]
    assert await ids(only_session="monday") == ["b", "c"]
    assert await ids(leave_distance_m=0.5) == ["d"]
    assert await ids(leave_distance_m=0.0) == ["b", "c", "d"]
    for session_id, near in (("monday", ["b", "c"]), ("tuesday", ["d"])):
        assert await ids(prior_position_m=(1.0, 0.0, 0.0), radius_m=0.5, only_session=session_id) == near
    assert await ids(prior_position_m=(9.0, 0.0, 0.0), radius_m=0.5, only_session="monday") == []
    with pytest.raises(BadField, match="only_session"):
        await ids(prior_position_m=(1.0, 0.0, 0.0), radius_m=0.5)
    for bad in ({"k": 0}, {"k": 101}, {"radius_m": 1.0}, {"min_similarity": 2.0}, {"leave_distance_m": -1.0}):
        with pytest.raises(BadField):
            await ids(**bad)


async def test_a_descriptor_of_another_model_is_refused(world):
    await described(world, a=1)
    stored = await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.DESCRIPTOR)
    vector = np.frombuffer(stored.data[-256:], dtype="<f4")
    found = await world.use_cases.searches.by_descriptor(TENANT, "town", vector, "fake-1", SearchCriteria())
    assert found.hits[0].submap == key("a")
    with pytest.raises(DescriptorModelMismatch):
        await world.use_cases.searches.by_descriptor(TENANT, "town", vector, "fake-2", SearchCriteria())
    with pytest.raises(BadField):
        await world.use_cases.searches.by_descriptor(TENANT, "town", vector[:10], "fake-1", SearchCriteria())


async def test_a_worker_with_another_model_does_not_add_to_a_map(world):
    await described(world, a=1)
    posted = await world.use_cases.posting.post(TENANT, submap("b", 2))
    newer = FakeRecogniser()
    newer.model_version = "fake-2"
    world.work_off(newer)
    operation = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert (operation.state, operation.failure_code) == (OperationState.FAILED, "DESCRIPTOR_MODEL_MISMATCH")


async def test_a_cloud_is_searched_and_localised_without_being_stored(world):
    await described(world, a=7, b=8)
    found = await answered(world, world.use_cases.searches.by_cloud(TENANT, "town", cloud(7), SearchCriteria(k=1)))
    assert found.hits[0].submap == key("a")
    where = await answered(world, world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(7))))
    assert where.best.submap == key("a") and len(where.candidates) == 2
    # The fake recogniser says 1 m ahead of the match, and the match was taken at x = 7 m.
    np.testing.assert_allclose(where.T_odom_query, pose(8.0))
    assert where.session == SESSION
    nowhere = await answered(world, world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(9))))
    assert nowhere.best is None and nowhere.T_odom_query is None and nowhere.session is None
    assert len((await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items) == 2


async def test_answers_are_forgotten_after_their_time_but_not_what_became_of_submaps(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 7))
    world.work_off()
    for wait_ms in (0, 3_000_000):
        world.clock.ms += wait_ms
        await answered(world, world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(7))))

    async def operations():
        page = await world.use_cases.operations.list(TENANT, PageRequest())
        return [operation.operation_id for operation in page.items]

    _, first, second = await operations()
    assert await forget_answers(world.context.storage, world.clock, 3600.0) == 0
    world.clock.ms += 1_000_000
    assert await forget_answers(world.context.storage, world.clock, 3600.0) == 1
    assert await operations() == [posted.operation.operation_id, second]
    with pytest.raises(NotFound):
        await world.use_cases.operations.get(TENANT, first)
    assert (await world.use_cases.posting.post(TENANT, submap("a", 7))).replay


async def test_a_search_by_cloud_that_is_refused_leaves_no_cloud_behind(tmp_path):
    world = sqlite_world(tmp_path, max_queued_jobs=1)
    await posted(world, a=1)
    with pytest.raises(WorkersBusy):
        await world.use_cases.searches.by_cloud(TENANT, "town", cloud(1), SearchCriteria())
    assert not list((tmp_path / "blobs").glob(f"*/{QUERY_CLOUD_BLOB}/*/*"))
    world.context.transactions.close()


async def test_a_search_by_cloud_that_no_worker_answers_ends_at_its_deadline(world):
    await open_session(world)
    with pytest.raises(RevisitError) as refused:
        await world.use_cases.searches.by_cloud(TENANT, "town", cloud(1), SearchCriteria(), timeout_s=0.05)
    assert refused.value.code == "NO_ANSWER"


async def jobs_of(world) -> list[str]:
    page = await world.use_cases.operations.list(TENANT, PageRequest())
    return [operation.state for operation in page.items]


async def test_a_query_that_nobody_waits_for_goes_with_its_cloud_and_its_job(tmp_path):
    world = sqlite_world(tmp_path)
    await open_session(world)
    with pytest.raises(RevisitError, match="the query was dropped"):
        await world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(1)), timeout_s=0.05)
    left = asyncio.create_task(world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(1))))
    while not await jobs_of(world):
        await asyncio.sleep(0.01)
    left.cancel()
    with pytest.raises(asyncio.CancelledError):
        await left
    async with asyncio.timeout(PATIENCE_S):
        while await jobs_of(world) or list((tmp_path / "blobs").glob(f"*/{QUERY_CLOUD_BLOB}/*/*")):
            await asyncio.sleep(0.01)
    assert world.work_off() == 0
    world.context.transactions.close()


async def test_the_late_result_of_a_query_that_was_dropped_is_refused(world):
    await described(world, a=1)
    asked = asyncio.create_task(
        world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(1)), timeout_s=0.3)
    )
    while (lease := world.claim()) is None:
        await asyncio.sleep(0.01)
    with pytest.raises(RevisitError, match="the query was dropped"):
        await asked
    world.worker().run(lease)
    assert await jobs_of(world) == ["DONE"]


async def test_a_stream_of_scans_is_cut_into_submaps_that_overlap(world):
    await open_session(world)
    completed = {}
    for seq in range(1, 22):
        ack = await world.use_cases.scans.append(TENANT, scan(seq, x_m=float(seq - 1)))
        assert ack.committed_seq == seq
        if ack.submap is not None:
            completed[seq] = ack.submap.submap.key.submap_id
    # One scan a metre, 10 m long, one every 5 m.
    assert completed == {11: "scans-1-11", 16: "scans-6-16", 21: "scans-11-21"}
    view = await world.use_cases.submaps.get(TENANT, key("scans-6-16"))
    assert (view.ordinal, view.scan_count, view.position_m) == (1, 11, (10.0, 0.0, 0.0))
    np.testing.assert_array_equal(pose_matrix(view.T_odom_submap), pose(10.0))
    assert world.work_off() == 3
    assert (await world.use_cases.submaps.get(TENANT, key("scans-1-11"))).state == SubmapState.DESCRIBED


async def test_a_scan_again_is_acknowledged_and_ignored_and_a_gap_is_refused(world):
    await open_session(world)
    for seq in (1, 2):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    again = await world.use_cases.scans.append(TENANT, scan(1, 1.0))
    assert (again.replay, again.committed_seq) == (True, 2)
    with pytest.raises(SequenceGap) as gap:
        await world.use_cases.scans.append(TENANT, scan(4, 4.0))
    assert gap.value.expected == 3
    assert (await world.use_cases.scans.open(TENANT, SESSION)).committed_seq == 2


async def test_a_stream_stores_nothing_in_a_later_session_of_the_same_name(world):
    await open_session(world)
    scans = world.use_cases.scans
    stream = ScanStream.of((await scans.open(TENANT, SESSION)).session_number)
    await world.use_cases.sessions.delete(TENANT, SESSION)
    await world.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id))
    with pytest.raises(NotFound, match="was deleted"):
        await scans.append(TENANT, replace(scan(1, 1.0), stream=stream))
    assert (await scans.append(TENANT, scan(1, 1.0))).committed_seq == 1


async def test_a_robot_that_restarted_is_told_to_take_a_new_session(world):
    await open_session(world)
    for seq in (1, 2):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    first = scan(1, 1.0)
    others = (
        replace(first, stamp_ns=first.stamp_ns + 10**12),
        replace(first, T_odom_sensor=pose(1.001)),
        replace(first, cloud=cloud(7)),
        replace(first, cloud=replace(first.cloud, columns={"intensity": np.ones(300, np.float32)})),
    )
    for other in others:
        with pytest.raises(AlreadyExists, match="create a new session; else go on with scan 3"):
            await world.use_cases.scans.append(TENANT, other)
    assert (await world.use_cases.scans.append(TENANT, first)).replay


async def test_a_scan_is_known_again_after_another_compressor_packed_it(world, monkeypatch):
    from revisit.service.features.ingest import calls as scans
    from revisit.service.features.ingest import clouds

    def packed_otherwise(accepted):
        blob = clouds.pack_cloud(accepted)
        header, body = blob[: clouds._HEADER.size], blob[clouds._HEADER.size :]
        planes = clouds.zstandard.ZstdDecompressor().decompress(body)
        return header + clouds.zstandard.ZstdCompressor(level=19).compress(planes)

    await open_session(world)
    monkeypatch.setattr(scans, "pack_cloud", packed_otherwise)
    await world.use_cases.scans.append(TENANT, scan(1, 1.0))
    monkeypatch.undo()
    assert (await world.use_cases.scans.append(TENANT, scan(1, 1.0))).replay
    with pytest.raises(AlreadyExists):
        await world.use_cases.scans.append(TENANT, replace(scan(1, 1.0), cloud=cloud(2)))


async def test_of_two_robots_that_send_the_same_number_at_once_one_is_refused(world):
    await open_session(world)
    calls = (
        world.use_cases.scans.append(TENANT, scan(1, 1.0)),
        world.use_cases.scans.append(TENANT, replace(scan(1, 1.0), cloud=cloud(9))),
    )
    outcomes = await asyncio.gather(*calls, return_exceptions=True)
    assert sorted(type(outcome).__name__ for outcome in outcomes) == ["AlreadyExists", "ScanAck"]


async def test_finishing_a_session_flushes_its_last_window_once(world):
    await open_session(world)
    for seq in range(1, 5):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    first = await world.use_cases.sessions.finish(TENANT, SESSION)
    again = await world.use_cases.sessions.finish(TENANT, SESSION)
    assert first == again and first.state == SessionState.FINISHED and first.submap_count == 1
    assert (await world.use_cases.submaps.get(TENANT, key("scans-1-4"))).first_seq == 1
    for call in (
        world.use_cases.scans.append(TENANT, scan(5, 5.0)),
        world.use_cases.scans.open(TENANT, SESSION),
        world.use_cases.posting.post(TENANT, submap("late", 1)),
    ):
        with pytest.raises(SessionFinished):
            await call
    assert (await world.use_cases.scans.append(TENANT, scan(2, 2.0))).replay


async def test_finishing_a_session_without_scans_makes_no_submap(world):
    await open_session(world)
    assert (await world.use_cases.sessions.finish(TENANT, SESSION)).submap_count == 0


async def test_downloads_give_back_what_was_sent_and_what_was_made(world):
    await posted(world, a=1)
    points = await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.POINTS, "ply")
    assert points.data.endswith(cloud_points(1).tobytes()) and points.filename == "monday-a-points.ply"
    with pytest.raises(NotReady):
        await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.MESH)
    world.work_off()
    mesh = await answered(world, world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.MESH))
    assert b"element vertex 3" in mesh.data and b"element face 1" in mesh.data
    neural = await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.NEURAL)
    assert neural.data.startswith(b"neural ")
    with pytest.raises(RevisitError, match="can be had as"):
        await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.MESH, "stl")


async def test_the_points_of_a_streamed_submap_are_its_scans_in_one_frame(world):
    await open_session(world)
    for seq in range(1, 12):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq - 1)))
    points = await world.use_cases.submaps.download(TENANT, key("scans-1-11"), DownloadKind.POINTS, "ply")
    cloud_end = np.frombuffer(points.data[-12:], dtype="<f4")
    # The middle of 11 scans is the 6th, 5 m behind the last.
    np.testing.assert_allclose(cloud_end, cloud_points(11)[-1] + [5.0, 0.0, 0.0], atol=1e-5)


async def test_deleting_a_submap_takes_its_loops_and_blobs_but_not_those_of_its_twin(world):
    await described(world, a=1, b=2, c=3, twin=1)
    await world.use_cases.submaps.delete(TENANT, key("a"))
    with pytest.raises(NotFound):
        await world.use_cases.submaps.get(TENANT, key("a"))
    assert not (await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.ACCEPTED)).items
    sha256 = world.context.transactions.read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "b")).result()
    await world.use_cases.submaps.delete(TENANT, key("b"))
    world.clock.ms += int(UNREFERENCED_S * 1000)
    await collect(world.context.storage)
    assert not world.context.blobs.exists(TENANT, CLOUD_BLOB, sha256.cloud_sha256)
    twin = await world.use_cases.submaps.download(TENANT, key("twin"), DownloadKind.POINTS)
    assert twin.data


async def test_deleting_a_map_leaves_nothing_and_its_name_can_be_used_again(world):
    await posted(world, a=1)
    await world.use_cases.scans.append(TENANT, scan(1, 0.0))
    world.work_off()
    await world.use_cases.maps.delete(TENANT, "town")
    with pytest.raises(NotFound):
        await world.use_cases.sessions.get(TENANT, SESSION)
    await described(world, a=1)
    found = await world.use_cases.searches.by_submap(TENANT, key("a"), SearchCriteria())
    assert (found.hits, found.searched) == ((), 1)


async def test_the_blobs_of_a_large_map_are_deleted_in_turns_that_let_others_write(tmp_path, monkeypatch):
    world = sqlite_world(tmp_path)
    await open_session(world)
    for place in range(5):
        await world.use_cases.posting.post(TENANT, submap(f"s{place}", place))
    monkeypatch.setattr(sweeping, "BLOBS_PER_TURN", 2)
    turns, delete = [], sweeping._deleted

    def noted(blobs, begun, until_s):
        turns.append(len(begun.blobs))
        return delete(blobs, begun, until_s)

    monkeypatch.setattr(sweeping, "_deleted", noted)
    await world.use_cases.maps.delete(TENANT, "town")
    world.clock.ms += int(UNREFERENCED_S * 1000)
    assert await collect(world.context.storage) == 5
    assert turns == [2, 2, 1]
    assert not [path for path in (tmp_path / "blobs").rglob("*") if path.is_file()]
    world.context.transactions.close()


async def test_a_job_of_a_submap_that_was_deleted_meanwhile_has_no_effect(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))
    await world.use_cases.submaps.delete(TENANT, key("a"))
    world.work_off()
    operation = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert operation.result == {"outcome": "the submap was deleted"}


async def test_a_cloud_that_cannot_be_described_fails_at_once_with_its_reason(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1, points=CANNOT_BE_DESCRIBED))
    assert world.work_off() == 1
    operation = await world.use_cases.operations.wait(TENANT, posted.operation.operation_id, 1.0)
    view = await world.use_cases.submaps.get(TENANT, key("a"))
    assert (operation.attempts, operation.failure_code) == (1, "UNUSABLE_CLOUD")
    assert (view.state, view.failure_code) == (SubmapState.FAILED, "UNUSABLE_CLOUD")


async def test_a_job_that_raises_is_tried_three_times_and_others_proceed(world):
    await open_session(world)
    poison = await world.use_cases.posting.post(TENANT, submap("poison", 1, points=RAISES))
    await world.use_cases.posting.post(TENANT, submap("good", 2))
    for _ in range(4):
        world.work_off()
        world.clock.ms += 60_000
    operation = await world.use_cases.operations.get(TENANT, poison.operation.operation_id)
    assert (operation.state, operation.attempts) == (OperationState.FAILED, 3)
    assert "the method has a fault" in operation.failure_message
    assert (await world.use_cases.submaps.get(TENANT, key("good"))).state == SubmapState.DESCRIBED


async def test_a_damaged_cloud_fails_its_own_job_only(tmp_path):
    world = sqlite_world(tmp_path)
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))
    await world.use_cases.posting.post(TENANT, submap("b", 2))
    row = world.context.transactions.read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "a")).result()
    blob = tmp_path / "blobs" / TENANT / CLOUD_BLOB / row.cloud_sha256[:2] / row.cloud_sha256
    data = bytearray(blob.read_bytes())
    data[len(data) // 2] ^= 1
    blob.write_bytes(data)
    world.work_off()
    operation = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert operation.failure_code == "DATA_LOSS"
    assert (await world.use_cases.submaps.get(TENANT, key("b"))).state == SubmapState.DESCRIBED
    with pytest.raises(DataLoss):
        await world.use_cases.submaps.download(TENANT, key("a"), DownloadKind.POINTS)
    world.context.transactions.close()


async def test_a_full_queue_refuses_posts_and_completing_scans_without_storing_them():
    world = memory_world(max_queued_jobs=1)
    await posted(world, a=1)
    with pytest.raises(WorkersBusy) as busy:
        await world.use_cases.posting.post(TENANT, submap("b", 2))
    assert busy.value.retry_after_s > 0
    for seq in range(1, 11):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    with pytest.raises(WorkersBusy):
        await world.use_cases.scans.append(TENANT, scan(11, 11.0))
    assert (await world.use_cases.scans.open(TENANT, SESSION)).committed_seq == 10
    world.work_off()
    assert (await world.use_cases.scans.append(TENANT, scan(11, 11.0))).submap is not None


async def test_a_draining_service_refuses_new_work_and_is_not_ready(world):
    await open_session(world)
    assert (await world.use_cases.system.readiness()).ready
    world.use_cases.system.drain()
    with pytest.raises(Draining):
        await world.use_cases.posting.post(TENANT, submap("a", 1))
    with pytest.raises(Draining):
        await world.use_cases.scans.append(TENANT, scan(1, 0.0))
    assert (await world.use_cases.system.readiness()).reasons == ("draining",)


async def test_lists_come_in_pages_that_join_without_gap_or_repeat(world):
    for number in range(7):
        await world.use_cases.maps.create(TENANT, CreateMap(f"m{number}"))
    seen, token = [], ""
    while True:
        page = await world.use_cases.maps.list(TENANT, PageRequest(size=3, token=token))
        seen += [view.map_id for view in page.items]
        token = page.next_token
        if not token:
            break
    assert seen == [f"m{number}" for number in range(7)]
    for forged in ("x", "YWZ0ZXI6LTE=", "é"):
        with pytest.raises(BadField):
            await world.use_cases.maps.list(TENANT, PageRequest(token=forged))


async def test_a_map_overrides_the_window_of_its_submaps(world):
    await world.use_cases.maps.create(TENANT, CreateMap("town", tau_m=2.0, stride_m=2.0, leave_distance_m=3.0))
    await world.use_cases.sessions.create(TENANT, CreateSession("town", "monday"))
    view = await world.use_cases.maps.get(TENANT, "town")
    assert (view.tau_m, view.stride_m, view.leave_distance_m) == (2.0, 2.0, 3.0)
    acks = [await world.use_cases.scans.append(TENANT, scan(seq, float(seq))) for seq in range(1, 6)]
    assert [ack.submap is not None for ack in acks] == [False, False, True, False, True]


class NotingRecogniser(FakeRecogniser):
    """Notes the rules of each verdict."""

    def __init__(self):
        self.rules = []

    def verify(self, query, match, similarity, config, initial=None):
        self.rules.append((config.verification.min_score, config.verification.max_seen_through))
        return super().verify(query, match, similarity, config, initial)


async def test_a_map_has_its_own_rules_for_loop_closures(world):
    policy = LoopPolicy(candidates=2, min_score=0.9)
    town = CreateMap("town", loop_policy=policy, leave_distance_m=0.0)
    await world.use_cases.maps.create(TENANT, town)
    await world.use_cases.sessions.create(TENANT, CreateSession("town", "monday"))
    for number in range(6):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", 1, points=300 + number))
    noting = NotingRecogniser()
    world.work_off(noting)
    # The submaps have 0, 1, 2, 3, 4 and 5 others to be compared with: at most 2 are.
    usual = world.context.policy.pipeline.verification
    assert noting.rules == [(0.9, usual.max_seen_through)] * (0 + 1 + 2 + 2 + 2 + 2)
    in_force = (await world.use_cases.maps.get(TENANT, "town")).loop_policy
    assert in_force == LoopPolicy(2, 0.9, usual.min_overlap, usual.max_seen_through)
    assert (await world.use_cases.maps.create(TENANT, town)).replay
    for other in (LoopPolicy(), LoopPolicy(candidates=2), LoopPolicy(min_score=0.9)):
        with pytest.raises(AlreadyExists):
            await world.use_cases.maps.create(TENANT, replace(town, loop_policy=other))
    with pytest.raises(BadField, match=r"loop_policy\.min_score"):
        await world.use_cases.maps.create(TENANT, CreateMap("other", loop_policy=LoopPolicy(min_score=1.5)))


async def test_watching_gives_the_loops_that_are_there_and_those_to_come(world):
    await posted(world, a=1, b=2, c=1, d=2)
    for _ in range(3):
        world.worker().run(world.claim())
    seen = []

    async def watch():
        async for loop in world.use_cases.loops.watch(TENANT, "town"):
            seen.append(loop.query.submap_id)

    task = asyncio.create_task(watch())
    while not seen:
        await asyncio.sleep(0.01)
    world.work_off()
    while len(seen) < 2:
        await asyncio.sleep(0.01)
    world.use_cases.system.drain()
    await task
    assert seen == ["c", "d"]


async def test_status_counts_jobs_and_submaps(world):
    await posted(world, a=1)
    await world.use_cases.posting.post(TENANT, submap("b", 2, points=CANNOT_BE_DESCRIBED))
    before = await world.use_cases.system.status(TENANT)
    world.work_off()
    after = await world.use_cases.system.status(TENANT)
    assert (before.queued_jobs, before.indexed_submaps) == (2, 0)
    assert (after.queued_jobs, after.failed_jobs, after.indexed_submaps) == (0, 1, 1)
