"""kill -9 of any process of an installation on PostgreSQL: gateways, workers, search processes, the database."""

from __future__ import annotations

import asyncio
import itertools
import random
import signal
import threading
import time
from contextlib import ExitStack, closing

import httpx
import pytest
from sqlalchemy import create_engine, text

from revisit.core.config import PipelineConfig
from revisit.formats import KITTI, encode_kitti
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from tests.support.campaigns import Campaign, sizes
from tests.support.drives_on_a_road import loops_of
from tests.support.patience import PATIENCE_S, eventually
from tests.support.processes import SearchProcess, ServiceProcess, WorkersProcess
from tests.support.service_world import TENANT, cloud_points, memory_world, submap

SESSION = "maps/town/sessions/monday"
PLACES = 12
ROBOTS = 3
SETTINGS = {"secret": "s" * 40, "lease_s": 2.0, "max_attempts": 100, "fake_delay_s": 0.02, "optimise_after_loops": 0}


class Robot:
    """Posts submap after submap to gateways in turn, each again until it is acknowledged."""

    def __init__(self, number, gateways, stop):
        self.acknowledged, self.surprises = {}, []
        self._number, self._gateways, self._stop = number, gateways, stop
        self.thread = threading.Thread(target=self._drive)

    def _drive(self):
        for count in itertools.count():
            submap_id, place = f"r{self._number}-{count}", (count * ROBOTS + self._number) % PLACES
            while not self._posted(submap_id, place):
                if self._stop.wait(0.1):
                    return
            self.acknowledged[submap_id] = place
            if self._stop.wait(0.1):
                return

    def _posted(self, submap_id, place):
        gateway = random.choice(self._gateways)
        asked = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
        body, headers = encode_kitti(cloud_points(place)), {"Content-Type": KITTI}
        try:
            url = f"{gateway.url}/v1/{SESSION}/submaps"
            answer = httpx.post(url, params=asked, content=body, headers=headers, timeout=20.0, trust_env=False)
        except httpx.TransportError:
            return False
        if answer.status_code not in (200, 202, 429, 503, 504):
            self.surprises.append(answer.text)
        return answer.status_code in (200, 202)


class Cluster:
    """Gateways, hosts of workers and search processes over one database and one folder of blobs."""

    def __init__(self, home, server, stack):
        self.server, self.url = server, server.made_database()
        address = self.url.render_as_string(hide_password=False)
        settings = {**SETTINGS, "database_url": address}
        self.gateways = [stack.enter_context(closing(ServiceProcess(home, workers=0, **settings))) for _ in range(2)]
        self.workers = [stack.enter_context(closing(WorkersProcess(home, workers=2, **settings)))]
        self.searches = [stack.enter_context(closing(SearchProcess(home, **settings))) for _ in range(2)]

    def kill_one(self, rng):
        """Kill a process, or now and then the database, and start it again."""
        if rng.random() < 0.1:
            self.server.stop(signal.SIGKILL)
            self.server.start()
            return "database"
        role = rng.choice(("gateways", "workers", "searches"))
        process = rng.choice(getattr(self, role))
        process.send(signal.SIGKILL)
        process.close()
        process.start()
        return role

    def rows(self, query):
        engine = create_engine(self.url)
        with engine.connect() as connection:
            found = connection.execute(text(query)).all()
        engine.dispose()
        return found


def worked_off(cluster):
    states = "SELECT count(*) FROM submaps WHERE state = 'QUEUED' OR NOT searched"
    eventually(lambda: cluster.rows(states)[0][0] == 0, "jobs are left", 300.0)
    jobs = "SELECT count(*) FROM jobs WHERE kind = 'DESCRIBE_SUBMAP' AND state IN ('QUEUED', 'RUNNING')"
    eventually(lambda: cluster.rows(jobs)[0][0] == 0, "jobs are left", 120.0)


def serially(rows):
    """The loops of a world where one worker does the same jobs in the order of entry."""
    world = memory_world(pipeline=PipelineConfig(), optimise_after_loops=0)
    key = SessionKey("town", "monday")

    async def post():
        await world.use_cases.maps.create(TENANT, CreateMap("town", leave_distance_m=0.0))
        await world.use_cases.sessions.create(TENANT, CreateSession("town", "monday"))
        for submap_id, place, *_ in sorted(rows, key=lambda row: row[3]):
            await world.use_cases.posting.post(TENANT, submap(submap_id, place, key))

    asyncio.run(post())
    leases = {}
    while (lease := world.claim(f"w{len(leases)}")) is not None:
        leases[lease.job.subject.rpartition("/")[2]] = lease
    worker = world.worker()
    for submap_id, *_ in sorted(rows, key=lambda row: row[2]):
        worker.run(leases[submap_id])
    return {(query[1], match[1]): verdict[:2] for (query, match), verdict in loops_of(world).items()}


@pytest.mark.parametrize("kills", sizes("CLUSTER_KILLS", 6, 500)[1:])
@pytest.mark.timeout(7200)
def test_nothing_is_lost_twice_missed_or_invented_whichever_process_is_killed(tmp_path, own_postgres, kills):
    rng, campaign, stop = random.Random(36), Campaign("P1", kills), threading.Event()
    killed = []
    with ExitStack() as stack:
        cluster = Cluster(tmp_path / "home", own_postgres, stack)
        made = cluster.gateways[0].url
        assert httpx.post(f"{made}/v1/maps", json={"map_id": "town", "leave_distance_m": 0}, trust_env=False).is_success
        session = {"session_id": "monday"}
        assert httpx.post(f"{made}/v1/maps/town/sessions", json=session, trust_env=False).is_success
        robots = [Robot(number, cluster.gateways, stop) for number in range(ROBOTS)]
        for robot in robots:
            robot.thread.start()
        try:
            for _ in campaign:
                seen = sum(len(robot.acknowledged) for robot in robots)
                eventually(
                    lambda seen=seen: sum(len(robot.acknowledged) for robot in robots) > seen,
                    "nothing is acknowledged any more",
                )
                time.sleep(rng.uniform(0.0, 0.5))
                killed.append(cluster.kill_one(rng))
        finally:
            stop.set()
            for robot in robots:
                robot.thread.join(PATIENCE_S)
        worked_off(cluster)
        require_all(cluster, robots)
    campaign.publish(f"killed {killed}")


def require_all(cluster, robots):
    acknowledged = {name: place for robot in robots for name, place in robot.acknowledged.items()}
    assert [surprise for robot in robots for surprise in robot.surprises] == []
    rows = cluster.rows("SELECT submap_id, stamp_ns, entered, ordinal, state FROM submaps")
    names = [row.submap_id for row in rows]
    assert len(names) == len(set(names)) and acknowledged.keys() <= set(names)
    assert {row.state for row in rows} == {"DESCRIBED"}
    for numbers in ("SELECT seq FROM events WHERE map_id = 'town'", "SELECT seq FROM index_changes"):
        given = sorted(row[0] for row in cluster.rows(numbers))
        assert given == list(range(1, len(given) + 1)), numbers
    found = {
        (query, match): (state, reason)
        for query, match, state, reason in cluster.rows(
            "SELECT query_submap_id, match_submap_id, state, reason FROM loop_closures"
        )
    }
    assert len(found) >= len(names) - PLACES
    assert found == serially([(row.submap_id, row.stamp_ns, row.entered, row.ordinal) for row in rows])
