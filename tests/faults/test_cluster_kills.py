"""kill -9 of any process of an installation on PostgreSQL, a host cut off, and its clock stepped by an hour."""

from __future__ import annotations

import random
import threading
import time

import pytest

from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from tests.faults.cluster import ROBOTS, Robot, acknowledged_to, cluster_in, lone_places, make_sessions
from tests.faults.stored_loops import ALIKE, require_all, worked_off
from tests.support.campaigns import Campaign, seed_of_this_run, sizes
from tests.support.drives_on_a_road import loops_of
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import TENANT, memory_world, submap


@pytest.fixture
def cluster(tmp_path):
    with cluster_in(tmp_path) as made:
        yield made


TWIN = 118
"""A place that looks as place 45 does."""


async def test_robots_see_no_two_places_that_are_alike():
    world, places = memory_world(optimise_after_loops=0), lone_places()[40:50]
    await world.use_cases.maps.create(TENANT, CreateMap("town", leave_distance_m=0.0))
    await world.use_cases.sessions.create(TENANT, CreateSession("town", "monday"))
    for place in (*places, TWIN):
        await world.use_cases.posting.post(TENANT, submap(f"s{place}", place))
    world.work_off()
    alike = {query[1] for (query, _), verdict in loops_of(world).items() if verdict[2] > ALIKE}
    assert alike == {f"s{TWIN}"} and TWIN not in lone_places()


def strike(cluster, campaign, robots, rng):
    """Faults by chance, each once something was acknowledged after the last one; how long that took."""
    recovered_s = []
    for number in campaign:
        seen = sum(len(robot.acknowledged) for robot in robots)
        fault = cluster.strike(rng)
        took_s = eventually(
            lambda seen=seen: sum(len(robot.acknowledged) for robot in robots) > seen,
            f"nothing is acknowledged any more after {fault}",
        )
        cluster.supervise()
        recovered_s.append((round(took_s, 1), fault))
        print(f"{number} {fault}: {took_s:.1f} s", flush=True)
        time.sleep(rng.uniform(0.0, 0.5))
    return recovered_s


@pytest.mark.parametrize("kills", sizes("CLUSTER_KILLS", 6, 500)[1:])
@pytest.mark.timeout(14_400)
def test_nothing_is_lost_twice_missed_or_invented_whatever_befalls_which_process(cluster, kills):
    seed, campaign, stop = seed_of_this_run(), Campaign("P1", kills), threading.Event()
    make_sessions(cluster.gateways[0])
    robots = [Robot(number, cluster.gateways, stop) for number in range(ROBOTS)]
    for robot in robots:
        robot.thread.start()
    try:
        recovered_s = strike(cluster, campaign, robots, random.Random(seed))
    finally:
        stop.set()
        for robot in robots:
            robot.thread.join(PATIENCE_S)
    worked_off(cluster.store)
    require_all(cluster.store, acknowledged_to(robots))
    acknowledged = len(acknowledged_to(robots))
    campaign.publish(
        f"seed {seed}, {dict(cluster.faults)}: 0 of {acknowledged} acknowledged lost, 0 twice, loops equal to a serial "
        f"run, events without gap; first acknowledgement after a fault at most {max(recovered_s)}"
    )
