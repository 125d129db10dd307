"""Metrics: what Prometheus reads."""

from __future__ import annotations

import shutil

import httpx
import pytest

from revisit.core.errors import DataLoss, ErrorCode
from revisit.service.domain.errors import Unavailable
from revisit.service.engines.local.files.disk import Disk
from revisit.service.metrics import GatewayMetrics, MetricsServer, RequestMetrics, StoreMetrics
from tests.support.service_world import TENANT, memory_world, open_session, sqlite_world, submap
from tests.support.stepped_clock import SteppedClock


def lines_of(server):
    answer = httpx.get(f"http://127.0.0.1:{server.port}/metrics", trust_env=False)
    assert answer.headers["content-type"].startswith("text/plain")
    return answer.text.splitlines()


@pytest.fixture
def metrics():
    """A world, its request metrics and the server over both."""
    world, requests = memory_world(), RequestMetrics()
    server = MetricsServer(requests, [StoreMetrics(world.context)], 0)
    yield world, requests, server
    server.close()


async def test_jobs_submaps_and_loops_are_counted_by_state(metrics):
    world, _, server = metrics
    await open_session(world)
    for number in range(4):
        await world.use_cases.posting.post(TENANT, submap(f"a{number}", place=7 + number % 2))
    assert 'revisit_jobs{state="QUEUED"} 4.0' in lines_of(server)
    world.work_off()
    found = lines_of(server)
    assert 'revisit_jobs{state="QUEUED"} 0.0' in found
    assert 'revisit_jobs{state="DONE"} 4.0' in found
    assert 'revisit_submaps{state="DESCRIBED"} 4.0' in found
    # a0 and a2 are one place, a1 and a3 another; the pairs between them are looked at and rejected.
    assert 'revisit_loop_closures{state="ACCEPTED"} 2.0' in found


async def test_the_oldest_queued_job_tells_how_long_it_has_waited(metrics):
    world, _, server = metrics
    assert "revisit_oldest_queued_job_seconds 0.0" in lines_of(server)
    await open_session(world)
    await world.use_cases.posting.post(TENANT, submap("first", place=1))
    world.clock.ms += 7_900
    await world.use_cases.posting.post(TENANT, submap("second", place=2))
    assert "revisit_oldest_queued_job_seconds 7.0" in lines_of(server)
    world.work_off()
    assert "revisit_oldest_queued_job_seconds 0.0" in lines_of(server)


async def test_a_job_that_waits_or_runs_after_a_lost_run_has_begun_again(metrics):
    world, _, server = metrics
    await open_session(world)
    await world.use_cases.posting.post(TENANT, submap("first", place=1))
    world.claim()
    assert "revisit_jobs_begun_again 0.0" in lines_of(server)
    world.clock.ms += world.context.policy.lease_ms + 1
    world.claim("another worker")
    assert "revisit_jobs_begun_again 1.0" in lines_of(server)
    world.work_off()


def test_room_on_the_disk_and_damaged_blobs_are_told(tmp_path):
    disk = Disk(tmp_path, 4096)
    disk.tend()
    world = sqlite_world(tmp_path, disk)
    server = MetricsServer(RequestMetrics(), [StoreMetrics(world.context)], 0)
    sha256 = world.context.blobs.put(TENANT, "cloud", b"points")
    found = lines_of(server)
    assert {"revisit_storage_full 0.0", "revisit_quarantined_blobs 0.0"} <= set(found)
    assert 0 < float(told(found, "revisit_disk_free_bytes")) <= shutil.disk_usage(tmp_path).total
    next(tmp_path.glob(f"blobs/*/*/*/{sha256}")).write_bytes(b"pointz")
    with pytest.raises(DataLoss):
        world.context.blobs.get(TENANT, "cloud", sha256)
    disk.release()
    assert {"revisit_storage_full 1.0", "revisit_quarantined_blobs 1.0"} <= set(lines_of(server))
    server.close()
    world.context.transactions.close()


def told(lines, name):
    """The value of a series without labels."""
    return next(line.partition(" ")[2] for line in lines if line.startswith(f"{name} "))


def test_a_refused_call_is_counted_under_its_reason(metrics):
    _, requests, server = metrics
    requests.refuse("grpc", ErrorCode.QUOTA)
    assert 'revisit_refused_calls_total{reason="QUOTA",transport="grpc"} 1.0' in lines_of(server)


def test_version_clock_and_end_of_the_certificate_are_told():
    clock = SteppedClock()
    server = MetricsServer(RequestMetrics(), [GatewayMetrics("0.2.0", clock, 2e9)], 0)
    found = lines_of(server)
    server.close()
    assert {'revisit_version{version="0.2.0"} 1.0', "revisit_certificate_expiry_seconds 2e+09"} <= set(found)
    assert float(told(found, "revisit_clock_seconds")) == clock.wall_ns() / 1e9


def test_drift_of_the_index_is_counted(metrics):
    world, _, server = metrics
    world.context.index_health.drift += 3
    assert "revisit_index_drift_total 3.0" in lines_of(server)


def test_requests_are_timed_under_their_call_and_status(metrics):
    _, requests, server = metrics
    requests.observe("http", "GET /v1/maps", "200", 0.02)
    requests.observe("http", "GET /v1/maps", "200", 3.0)
    labels = 'call="GET /v1/maps",status="200",transport="http"'
    found = lines_of(server)
    assert f"revisit_request_duration_seconds_count{{{labels}}} 2.0" in found
    assert f'revisit_request_duration_seconds_bucket{{call="GET /v1/maps",le="0.025",{labels[20:]}}} 1.0' in found


def test_a_store_that_does_not_answer_leaves_the_other_metrics(metrics, monkeypatch):
    world, requests, server = metrics

    def refuse(work):
        raise Unavailable

    monkeypatch.setattr(world.context.transactions, "read", refuse)
    requests.observe("grpc", "/revisit.v1.MapService/GetMap", ErrorCode.NOT_FOUND.value, 0.001)
    found = lines_of(server)
    assert any(line.startswith("revisit_request_duration_seconds_count") for line in found)
    assert not any(line.startswith("revisit_jobs") for line in found)


@pytest.mark.parametrize(("host", "status"), [("localhost:1", 200), ("127.0.0.1:1", 200), ("evil.example:1", 403)])
def test_metrics_are_told_only_under_names_of_loopback(metrics, host, status):
    _, _, server = metrics
    url = f"http://127.0.0.1:{server.port}/metrics"
    assert httpx.get(url, headers={"host": host}, trust_env=False).status_code == status


@pytest.mark.parametrize(
    ("host", "status"),
    [("10.0.0.5:1", 200), ("[::1]:1", 200), ("maps.example:1", 200), ("localhost:1", 200), ("evil.example:1", 403)],
)
def test_metrics_on_another_address_are_told_to_addresses_and_known_names(host, status):
    server = MetricsServer(RequestMetrics(), [], 0, "0.0.0.0", frozenset({"maps.example"}))
    answer = httpx.get(f"http://127.0.0.1:{server.port}/metrics", headers={"host": host}, trust_env=False)
    server.close()
    assert answer.status_code == status
