"""A host whose cable is out: the others go on without it, it notices, and goes on once the cable is back."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from contextlib import closing

import pytest

from tests.faults.cluster import Robot, acknowledged_to, cluster_in, make_sessions
from tests.faults.other_host import OtherHost, possible
from tests.faults.stored_loops import require_all, worked_off
from tests.support.patience import PATIENCE_S, eventually, in_time
from tests.support.postgres import PostgresServer, new_folder
from tests.support.processes import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(not possible(), reason="no second host can be made here: that takes root and namespaces"),
]

GIVEN_UP_S = 15.0
CUT_S = 40.0

READER = """
import sys, time
from revisit.service.domain.errors import StorageUncertain
from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.transactions import PostgresTransactions

store = PostgresTransactions(server_url(sys.argv[1]), clock=SystemClock())
while True:
    try:
        store.write(lambda uow: uow.now_ms()).result()
        print("read", flush=True)
    except StorageUncertain as error:
        print(f"given up: {error.message}", flush=True)
    time.sleep(0.5)
"""


@pytest.fixture
def cluster(tmp_path):
    with cluster_in(tmp_path) as made:
        yield made


def test_a_database_that_is_cut_off_is_given_up_and_asked_again_once_it_is_back(tmp_path):
    with closing(OtherHost(tmp_path)) as host:
        server = PostgresServer(new_folder(), listens=host.here, network=host.network)
        server.start()
        url = server.url_from_afar(server.made_database()).render_as_string()
        command = [*host.launcher, sys.executable, "-c", READER, url]
        reader = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            assert reader.stdout.readline() == "read\n"
            host.cut()
            began_s = time.monotonic()
            while (line := reader.stdout.readline()) == "read\n":
                pass
            assert line.startswith("given up: the database failed"), line
            assert in_time(time.monotonic() - began_s, GIVEN_UP_S)
            host.plug()
            eventually(lambda: reader.stdout.readline() == "read\n", "it is not read any more")
        finally:
            reader.kill()
            reader.wait()
            server.end()


def test_the_others_go_on_while_a_host_is_cut_off_and_it_goes_on_afterwards(cluster):
    make_sessions(cluster.gateways[0])
    stop = threading.Event()
    robot = Robot(0, cluster.gateways[:2], stop)
    robot.thread.start()
    searched = "SELECT count(*) FROM submaps WHERE searched"
    try:
        eventually(lambda: cluster.store.rows(searched)[0][0] > 2)
        cluster.other.cut()
        before, cut_at_s = cluster.store.rows(searched)[0][0], time.monotonic()
        told_s = eventually(lambda seen=len(robot.acknowledged): len(robot.acknowledged) > seen + 1)
        searched_s = eventually(lambda: cluster.store.rows(searched)[0][0] > before + 8, "no loops are looked for")
        time.sleep(max(0.0, 40.0 - (time.monotonic() - cut_at_s)))
        others = [
            pid
            for (pid,) in cluster.store.rows(
                f"SELECT pid FROM pg_stat_activity WHERE client_addr = '{cluster.other.address}'"
            )
        ]
        cluster.other.plug()
        robot.gateways = cluster.gateways[2:]
        back_s = eventually(lambda seen=len(robot.acknowledged): len(robot.acknowledged) > seen + 1)
    finally:
        stop.set()
        robot.thread.join(PATIENCE_S)
    worked_off(cluster.store)
    require_all(cluster.store, acknowledged_to([robot]))
    print(f"acknowledged {told_s:.1f}, searched {searched_s:.1f}, back {back_s:.1f} s, sessions left {len(others)}")
