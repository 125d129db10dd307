"""kill -9 and SIGTERM, one step at a time; for kills at random moments see tests/faults/test_kill_campaign.py."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import httpx
import pytest

from revisit.formats import KITTI, encode_kitti
from tests.support.fake_recogniser import KILLS_THE_WORKER
from tests.support.processes import ROOT, ServiceProcess, is_running
from tests.support.service_world import cloud_points

SESSION = "/v1/maps/town/sessions/monday"


@pytest.fixture
def service(tmp_path):
    running = ServiceProcess(tmp_path / "home", fake_delay_s="0.02", min_index_gap=2)
    yield running
    running.close()


def body(place: int, points: int = 300) -> bytes:
    return encode_kitti(cloud_points(place, points))


def post_submap(client: httpx.Client, submap_id: str, place: int, points: int = 300) -> httpx.Response:
    parameters = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
    return client.post(
        f"{SESSION}/submaps", params=parameters, content=body(place, points), headers={"Content-Type": KITTI}
    )


def post_scan(client: httpx.Client, seq: int) -> httpx.Response:
    parameters = {"seq": seq, "stamp_ns": seq, "T_odom_sensor": f"{seq - 1},0,0,0,0,0,1"}
    return client.post(f"{SESSION}/scans", params=parameters, content=body(seq), headers={"Content-Type": KITTI})


def open_session(service: ServiceProcess) -> None:
    with httpx.Client(base_url=service.url, timeout=10) as client:
        assert client.post("/v1/maps", json={"map_id": "town"}).status_code == 201
        assert client.post("/v1/maps/town/sessions", json={"session_id": "monday"}).status_code == 201


def submaps(service: ServiceProcess) -> list[dict]:
    with httpx.Client(base_url=service.url, timeout=10) as client:
        listed = client.get(f"{SESSION}/submaps", params={"page_size": 500}).json()["submaps"]
    return [{**submap, "submap_id": submap["name"].rpartition("/")[2]} for submap in listed]


def wait_until_worked_off(service: ServiceProcess, timeout_s: float = 40.0) -> list[dict]:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        found = submaps(service)
        if all(submap["state"] != "QUEUED" for submap in found):
            return found
        time.sleep(0.1)
    raise AssertionError(f"still queued: {[s for s in submaps(service) if s['state'] == 'QUEUED']}")


def test_an_unfinished_window_of_scans_survives_a_kill(service):
    open_session(service)
    with httpx.Client(base_url=service.url, timeout=10) as client:
        for seq in range(1, 9):
            assert post_scan(client, seq).json()["committed_seq"] == str(seq)
    service.kill()
    service.start()
    with httpx.Client(base_url=service.url, timeout=10) as client:
        assert client.get(SESSION).json()["committed_seq"] == "8"
        assert post_scan(client, 8).json()["committed_seq"] == "8"
        for seq in range(9, 17):
            assert post_scan(client, seq).json()["committed_seq"] == str(seq)
    assert [submap["submap_id"] for submap in wait_until_worked_off(service)] == ["scans-1-11", "scans-6-16"]


def test_a_submap_that_kills_its_worker_fails_after_three_attempts_and_others_proceed(service):
    open_session(service)
    with httpx.Client(base_url=service.url, timeout=10) as client:
        poison = post_submap(client, "poison", 1, points=KILLS_THE_WORKER)
        post_submap(client, "good", 2)
        states = {submap["submap_id"]: submap["state"] for submap in wait_until_worked_off(service)}
        assert states == {"poison": "FAILED", "good": "DESCRIBED"}
        operation = client.get(f"/v1/{poison.json()['operation']['name']}").json()
    assert (operation["state"], operation["attempts"]) == ("FAILED", 3)


def test_sigterm_drains_and_leaves_no_process(service):
    open_session(service)
    service.wait_for("worker_ready")
    with httpx.Client(base_url=service.url, timeout=10) as client:
        for number in range(5):
            assert post_submap(client, f"s{number}", number).status_code == 202
    workers = service.worker_pids()
    status, took_s = service.terminate()
    assert workers and not any(is_running(pid) for pid in workers)
    assert status == 0 and took_s < 15
    service.start()
    assert {submap["state"] for submap in wait_until_worked_off(service)} == {"DESCRIBED"}


def test_a_worker_that_is_still_loading_does_not_delay_the_end(tmp_path):
    service = ServiceProcess(tmp_path / "home", fake_load_s=30)
    try:
        service.wait_for("worker_loading")
        status, took_s = service.terminate()
        assert status == 0 and took_s < 5
    finally:
        service.close()


def test_an_address_that_others_can_reach_ends_the_start_with_78_and_a_message(tmp_path):
    environment = {**os.environ, "REVISIT_HOME": str(tmp_path), "REVISIT_HOST": "0.0.0.0"}
    command = [sys.executable, "-m", "revisit.service", "serve"]
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == 78 and "REVISIT_INSECURE_BIND=1" in ended.stderr
    assert list(tmp_path.iterdir()) == []
