"""Retention removes what the policy of a map does not keep, and nothing that the map, a review or a job needs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.core.config import PipelineConfig
from revisit.service.domain.errors import NotFound, NotKept
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.retention import KeptScans, RetentionRule, parsed
from revisit.service.domain.states import SubmapState
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.ingest.rows import submap_source
from revisit.service.features.resources.paging import PageRequest
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED
from tests.support.retained import (
    HOUR_MS,
    blobs_of,
    driven,
    kept_scans,
    policy_set,
    retained,
    stored_seqs,
    streamed,
)
from tests.support.service_world import (
    SESSION,
    TENANT,
    memory_world,
    posted,
    postgres_world,
    scan,
    sqlite_world,
    submap,
)

OTHER = TenantId("other")
SCANS = 30


@pytest.fixture(params=[memory_world, sqlite_world, postgres_world], ids=["memory", "sqlite", "postgres"])
def world(request, tmp_path):
    made = request.param(tmp_path) if request.param is sqlite_world else request.param()
    yield made
    made.context.transactions.close()


async def first_submap(world, session: SessionKey = SESSION):
    return (await world.use_cases.submaps.list(TENANT, session, PageRequest())).items[0]


async def test_everything_is_kept_without_a_policy(world):
    await driven(world, SCANS)
    world.clock.ms += 1000 * 24 * HOUR_MS
    assert await retained(world) is None
    assert stored_seqs(world) == list(range(1, SCANS + 1))


async def test_scans_go_so_many_hours_after_their_submap_was_described(world):
    await driven(world, SCANS)
    world.clock.ms += 23 * HOUR_MS
    assert await retained(world, "scans=24h") is None
    world.clock.ms += 2 * HOUR_MS
    report = await retained(world)
    (scans,) = report.rules
    assert (scans.rule, scans.scans) == (RetentionRule.SCANS, SCANS)
    assert stored_seqs(world) == [] and set(kept_scans(world)) == {"NONE"}
    assert blobs_of(world, "cloud") == 0 and blobs_of(world, "neural-map") > 0


async def test_a_submap_says_that_its_scans_are_gone(world):
    await driven(world, SCANS)
    await retained(world, "scans=none")
    one = await first_submap(world)
    assert (one.state, one.kept_scans) == (SubmapState.DESCRIBED, KeptScans.NONE)
    with pytest.raises(NotKept, match="policy of retention"):
        await world.use_cases.submaps.download(TENANT, one.key, DownloadKind.POINTS)
    assert (await world.use_cases.submaps.download(TENANT, one.key, DownloadKind.NEURAL)).data


async def test_a_session_still_says_when_it_was_last_heard_of(world):
    await driven(world, SCANS)
    before = await world.use_cases.sessions.get(TENANT, SESSION)
    await retained(world, "scans=none")
    assert await world.use_cases.sessions.get(TENANT, SESSION) == before


async def test_a_window_that_is_not_full_keeps_its_scans_and_a_drive_goes_on(world):
    await streamed(world, 28)
    await retained(world, "scans=none")
    left = stored_seqs(world)
    assert left and left[-1] == 28 and 1 not in left
    await streamed(world, 12, first=29)
    await world.use_cases.sessions.finish(TENANT, SESSION)
    world.work_off()
    assert {one.state for one in await submaps(world)} == {SubmapState.DESCRIBED}


async def submaps(world, session: SessionKey = SESSION):
    return (await world.use_cases.submaps.list(TENANT, session, PageRequest())).items


async def test_a_scan_that_comes_again_after_its_cloud_went_is_acknowledged(world):
    await driven(world, SCANS)
    await retained(world, "scans=none")
    for seq in (3, SCANS):
        ack = await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
        assert (ack.replay, ack.committed_seq) == (True, SCANS)


async def test_the_scans_of_a_description_stay_and_describe_it_again(tmp_path):
    few = replace(PipelineConfig().submap, enough_returns=0)
    world = sqlite_world(tmp_path, pipeline=replace(PipelineConfig(), submap=few))
    await streamed_densely(world)
    before = sources(world)
    report = await retained(world, "scans=described")
    assert report.rules[0].scans > 0
    assert set(kept_scans(world)) == {"DESCRIBED"}
    assert sources(world) == before
    assert await retained(world) == report, "a second run removes nothing more"
    world.context.transactions.close()


async def streamed_densely(world) -> None:
    """Ten scans a metre, of which one is described."""
    await streamed(world, 0)
    for seq in range(1, 251):
        await world.use_cases.scans.append(TENANT, scan(seq, 0.1 * seq))
    await world.use_cases.sessions.finish(TENANT, SESSION)
    world.work_off()


def sources(world) -> list:
    def read(uow):
        return [submap_source(uow, world.context.policy, one) for one in uow.submaps.find(TENANT)]

    return [[cloud.stamp_ns for cloud in one.clouds] for one in world.context.transactions.read(read).result()]


async def test_what_waits_for_a_worker_or_has_failed_keeps_its_scans(world):
    await posted(world, waiting=1)
    bad = replace(submap("bad", 2), cloud=submap("bad", 2, points=CANNOT_BE_DESCRIBED).cloud)
    await world.use_cases.posting.post(TENANT, bad)
    world.clock.ms += HOUR_MS
    assert await retained(world, "scans=none") is None
    world.work_off()
    await retained(world)
    states = {one.key.submap_id: (one.state, one.kept_scans) for one in await submaps(world)}
    assert states == {"waiting": ("DESCRIBED", "NONE"), "bad": ("FAILED", "ALL")}


async def test_the_maps_of_other_tenants_stay(world):
    await driven(world, SCANS)
    await driven(world, SCANS, tenant=OTHER)
    await retained(world, "scans=none")
    assert stored_seqs(world) == [] and len(stored_seqs(world, tenant=OTHER)) == SCANS
    with pytest.raises(NotFound):
        await world.use_cases.retention.get(OTHER, "nowhere")


async def test_the_policy_of_the_service_is_that_of_maps_without_one_of_their_own(tmp_path):
    world = sqlite_world(tmp_path, retention=parsed("scans=none"))
    await driven(world, SCANS)
    await policy_set(world, "scans=all")
    await retained(world)
    assert len(stored_seqs(world)) == SCANS
    await world.use_cases.retention.set(TENANT, SESSION.map_id, None)
    await retained(world)
    assert stored_seqs(world) == []
    world.context.transactions.close()


async def test_a_posted_cloud_goes_by_the_same_rule(world):
    await posted(world, a=1)
    world.work_off()
    await retained(world, "scans=described")
    assert blobs_of(world, "cloud") == 1
    await retained(world, "scans=none")
    assert blobs_of(world, "cloud") == 0
    key = SubmapKey(SESSION.map_id, SESSION.session_id, "a")
    assert (await world.use_cases.submaps.get(TENANT, key)).kept_scans == KeptScans.NONE
    replay = await world.use_cases.posting.post(TENANT, submap("a", 1))
    assert replay.replay
