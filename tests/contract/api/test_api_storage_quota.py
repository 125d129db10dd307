"""What a tenant may store is bounded, on both transports; others go on, and what is deleted makes room."""

from __future__ import annotations

import queue
import subprocess
import sys

import numpy as np
import pytest

from revisit import ApiError
from revisit.evaluation.datasets import write_kitti
from revisit.sdk.anchors import NewAnchor
from revisit.service.capacity import storage_quota
from revisit.service.capacity.limits import POINT_BYTES, STORED_ANCHOR_POINTS
from revisit.service.domain.errors import QuotaReached
from revisit.service.domain.identity import TenantId
from tests.support.live_service import connected, live_service
from tests.support.made_pictures import a_png, part
from tests.support.patience import PATIENCE_S
from tests.support.requirements import ROOT
from tests.support.service_world import TENANT, cloud_points, memory_world, open_session, pose, posted, scan, submap

POINTS = 300
ROOM = 3 * POINTS * POINT_BYTES
OTHER = TenantId("other")


@pytest.fixture(params=["rest", "grpc"])
def client(request):
    with live_service(tenant_storage_bytes=ROOM) as service, connected(service, request.param) as made:
        made.create_session(made.create_map("town"), "monday")
        yield made


def post(client, number):
    return client.post_submap("maps/town/sessions/monday", f"s{number}", cloud_points(number, POINTS), pose(), 1)


def test_a_tenant_that_has_stored_what_it_may_is_refused_until_it_deletes_something(client, monkeypatch):
    for number in range(3):
        post(client, number)
    with pytest.raises(ApiError) as refused:
        post(client, 3)
    error = refused.value
    assert (error.reason, error.code, error.retryable) == ("QUOTA", "RESOURCE_EXHAUSTED", True)
    assert error.retry_after_s > 1.0
    post(client, 2)  # What is stored already takes no more room.
    client.delete("maps/town/sessions/monday/submaps/s0")
    monkeypatch.setattr(storage_quota, "QUOTA_RECOUNT_S", 0.0)
    post(client, 3)


def test_anchors_count_until_they_are_deleted(client, monkeypatch):
    monkeypatch.setattr(storage_quota, "QUOTA_RECOUNT_S", 0.0)
    session, most = "maps/town/sessions/monday", ROOM // (STORED_ANCHOR_POINTS * POINT_BYTES)
    fixes = [
        NewAnchor(f"fix-{n}", "GNSS", n, (1.0, 1.0, 2.0), geodetic=(48.0, 11.0, 500.0), T_odom_sensor=np.eye(4))
        for n in range(most + 1)
    ]
    client.sessions.post_anchors(session, fixes[:most])
    with pytest.raises(ApiError) as refused:
        client.sessions.post_anchors(session, fixes[most:])
    assert refused.value.reason == "QUOTA"
    with pytest.raises(ApiError):
        post(client, 0)
    client.sessions.post_anchors(session, fixes[:most])  # Those that are stored take no more room.
    client.sessions.delete_anchor(f"{session}/anchors/fix-0")
    client.sessions.post_anchors(session, fixes[most:])


def test_the_pictures_of_plans_count_until_they_are_deleted(client, monkeypatch):
    monkeypatch.setattr(storage_quota, "QUOTA_RECOUNT_S", 0.0)
    pins, large = [((0, 0), (0.0, 0.0)), ((9, 0), (9.0, 0.0))], a_png(40, 30, part(b"noTh", bytes(ROOM)))
    made = client.plans.create("maps/town", "ground", large, pins)
    client.plans.create("maps/town", "ground", large, pins)  # What is stored already takes no more room.
    for refused in (lambda: client.plans.create("maps/town", "first", a_png(), pins), lambda: post(client, 0)):
        with pytest.raises(ApiError) as error:
            refused()
        assert error.value.reason == "QUOTA"
    client.plans.delete(made)
    client.plans.create("maps/town", "first", a_png(), pins)


async def test_scans_count_and_what_another_tenant_has_does_not():
    world = memory_world(tenant_storage_bytes=ROOM)
    await open_session(world)
    await posted(world, tenant=OTHER, a=1, b=2)
    for seq in range(1, 4):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    with pytest.raises(QuotaReached):
        await world.use_cases.scans.append(TENANT, scan(4, 4.0))
    assert (await world.use_cases.scans.append(TENANT, scan(3, 3.0))).replay
    await world.use_cases.posting.post(OTHER, submap("c", 3))
    with pytest.raises(QuotaReached):
        await world.use_cases.posting.post(OTHER, submap("d", 4))


async def test_a_submap_of_scans_is_not_counted_beside_its_scans():
    world = memory_world(tenant_storage_bytes=14 * POINTS * POINT_BYTES)
    await open_session(world)
    for seq in range(1, 14):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq)))
    # Only a count from the rows sees the submap that came with the scans.
    world.context.quota._stored.clear()
    world.context.quota._counted_s.clear()
    assert world.context.transactions.read(lambda uow: uow.submaps.count(TENANT)).result() > 0
    await world.use_cases.scans.append(TENANT, scan(14, 14.0))
    with pytest.raises(QuotaReached):
        await world.use_cases.scans.append(TENANT, scan(15, 15.0))


@pytest.mark.parametrize("gateways", [1, 3])
async def test_several_gateways_together_store_no_more_than_a_tenant_may(gateways):
    worlds = [memory_world(tenant_storage_bytes=30 * POINTS * POINT_BYTES)]
    worlds += [worlds[0].another_gateway() for _ in range(gateways - 1)]
    now_s = [0.0]
    for world in worlds:
        world.context.share.gateways = gateways
        world.context.quota._now_s = lambda: now_s[0]
    await open_session(worlds[0])
    stored = 0
    for number in range(60):
        now_s[0] += storage_quota.QUOTA_RECOUNT_S
        try:
            await worlds[number % gateways].use_cases.posting.post(TENANT, submap(f"s{number}", number))
        except QuotaReached:
            continue
        stored += 1
    assert stored == 30


async def test_without_a_setting_there_is_no_limit():
    world = memory_world()
    await posted(world, **{f"s{number}": number for number in range(5)})
    assert world.context.quota is None


def test_a_stream_that_a_full_quota_stops_says_so_while_it_waits():
    told = queue.SimpleQueue()
    with live_service(tenant_storage_bytes=ROOM) as service, connected(service, "grpc") as client:
        session = client.create_session(client.create_map("town"), "monday")
        opened = client.stream(session, on_delay=lambda reason, message: told.put((reason, message)))
        stream = opened.__enter__()
        for number in range(1, 6):
            stream.send(cloud_points(number, POINTS), pose(float(number)), number)
        reason, message = told.get(timeout=PATIENCE_S)
        stream.close()
    assert reason == "QUOTA" and "all it may store" in message


def test_an_ingest_that_a_full_quota_stops_says_so_at_once(tmp_path):
    recording = tmp_path / "drive"
    write_kitti(recording, ((cloud_points(n, POINTS), pose(float(n)), n * 10**8) for n in range(6)))
    with live_service(tenant_storage_bytes=ROOM) as service:
        command = [sys.executable, "-m", "revisit.cli", "ingest", str(recording), "--grpc", service.grpc]
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as ingest:
            line = next(line for line in ingest.stderr if "QUOTA" in line)
            ingest.kill()
    assert line.startswith("revisit: the service takes no scan now: QUOTA: ") and "all it may store" in line
