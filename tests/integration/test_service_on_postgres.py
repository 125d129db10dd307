"""The service on PostgreSQL: gateways and workers in processes and data folders of their own, which are killed."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager

import httpx
import pytest
from sqlalchemy import create_engine, text

from tests.support.patience import eventually
from tests.support.processes import ServiceProcess, WorkersProcess
from tests.support.town import NEVER_TOO_NEAR, SESSION, running_town

ROUNDS = 3


def address(url) -> str:
    """As a setting."""
    return url.render_as_string(hide_password=False)


@contextmanager
def workers_elsewhere(tmp_path, url, **settings):
    """Workers with a data folder of their own: the blobs alone are those of the service."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "home" / "blobs").mkdir(exist_ok=True)
    (tmp_path / "elsewhere" / "blobs").symlink_to(tmp_path / "home" / "blobs")
    process = WorkersProcess(tmp_path / "elsewhere", database_url=address(url), **settings)
    try:
        yield process
    finally:
        process.close()


def test_workers_of_another_data_folder_describe_what_a_gateway_takes_and_end_when_told(tmp_path, postgres_url):
    of_town = {"database_url": address(postgres_url), "workers": 0, "of_map": NEVER_TOO_NEAR}
    with running_town(tmp_path / "home", **of_town) as town:
        with workers_elsewhere(tmp_path, postgres_url) as workers:
            operations = [town.posted(name, 1) for name in "ab"]
            assert [town.ended(operation)["state"] for operation in operations] == ["DONE", "DONE"]
            loops = town.http.get("/v1/maps/town/loopClosures").json()["loop_closures"]
            assert [loop["state"] for loop in loops] == ["ACCEPTED"]
            workers.send(signal.SIGTERM)
            workers.wait_for("stopped")
        assert [path.name for path in (tmp_path / "home").glob("*.db*")] == []


def test_what_one_gateway_takes_another_one_tells(tmp_path, postgres_url):
    with running_town(tmp_path / "home", database_url=address(postgres_url)) as town:
        second = ServiceProcess(tmp_path / "home", database_url=address(postgres_url), workers=0)
        try:
            town.posted("a", 1)
            states = httpx.get(f"{second.url}/v1/{SESSION}/submaps", trust_env=False)
            assert [submap["name"] for submap in states.json()["submaps"]] == [f"{SESSION}/submaps/a"]
            town.worked_off()
            ready = f"{second.url}/readyz"
            eventually(lambda: httpx.get(ready, trust_env=False).status_code == 200, "it is not ready")
        finally:
            second.close()


def test_a_server_that_is_away_is_told_and_nothing_is_stored_until_it_is_back(tmp_path, own_postgres):
    with running_town(tmp_path / "home", database_url=address(own_postgres.made_database())) as town:
        assert town.append(1) == 1
        own_postgres.stop(signal.SIGKILL)
        refused = town.send_scan(2)
        assert refused.status_code == 503 and "STORAGE_UNCERTAIN" in refused.text
        assert town.http.get("/livez").status_code == 200
        own_postgres.start()
        assert town.append(2) == 2


@pytest.mark.parametrize("killed", [pytest.param("gateway", marks=pytest.mark.slow), "server"])
def test_no_scan_is_lost_or_stored_twice_whoever_is_killed_while_scans_come_in(tmp_path, own_postgres, killed):
    url = own_postgres.made_database()
    with running_town(tmp_path / "home", database_url=address(url), workers=0) as town:
        robot = Robot(town)
        robot.thread.start()
        for _ in range(ROUNDS):
            seen = robot.acknowledged
            eventually(lambda seen=seen: robot.acknowledged >= seen + 20, "nothing is acknowledged")
            if killed == "gateway":
                town.service.kill()
                town.service.start()
            else:
                own_postgres.stop(signal.SIGKILL)
                own_postgres.start()
        last = robot.ended()
        engine = create_engine(url)
        with engine.connect() as connection:
            stored = connection.execute(text("SELECT seq FROM scans ORDER BY seq")).scalars().all()
        engine.dispose()
    assert last >= ROUNDS * 20
    assert stored == list(range(1, last + 1))


class Robot:
    """Sends scan after scan, each again until it is acknowledged."""

    def __init__(self, town) -> None:
        self.acknowledged, self._town, self._stop = 0, town, threading.Event()
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
