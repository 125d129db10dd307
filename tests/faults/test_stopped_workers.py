"""A worker process stands still in its job until another has done it, and then goes on: nothing of it counts (P15)."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from revisit import Client, Cloud
from revisit.formats import KITTI
from revisit.sdk.resources import Operation
from tests.faults.robots import body
from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes
from tests.support.fake_recogniser import NOWHERE
from tests.support.patience import eventually
from tests.support.processes import ForkedService, WorkerProcess, is_free
from tests.support.service_world import pose
from tests.support.state import ON_POSTGRES
from tests.support.town import SESSION

MISTAKEN = "tests.support.fake_recogniser:load_mistaken"
NO_VERSIONS = {"optimise_after_loops": 0}
"""In a minute the map would have a version, which judges the loop once more."""


def is_stopped(pid: int) -> bool:
    return "\nState:\tT" in Path(f"/proc/{pid}/status").read_text()


@contextmanager
def stopped(worker: WorkerProcess, home: Path) -> Iterator[None]:
    """The worker stands still within the block, but not in a transaction: that would hold up everybody.

    A server ends the transaction of such a worker after 10 s.
    """
    locks = () if ON_POSTGRES else (home / "revisit.db.writer", home / "revisit.db.turn")
    while True:
        worker.send(signal.SIGSTOP)
        eventually(lambda: is_stopped(worker.pid), "it does not stop")
        if all(is_free(lock) for lock in locks):
            break
        worker.send(signal.SIGCONT)
    yield
    worker.send(signal.SIGCONT)


@pytest.fixture
def client(folder) -> Iterator[Client]:
    """Of a gateway that starts no workers and watches over none."""
    with closing(ForkedService(folder / "home", workers=0, **NO_VERSIONS)) as service, Client(service.url) as made:
        made.create_session(made.create_map("town", leave_distance_m=0), "monday")
        yield made


@pytest.fixture
def start_worker(folder) -> Iterator[Callable[..., WorkerProcess]]:
    with ExitStack() as workers:
        home = folder / "home"
        yield lambda **settings: workers.enter_context(closing(WorkerProcess(home, **NO_VERSIONS, **settings)))


def post(client: Client, submap_id: str, place: int) -> Operation:
    return client.post_submap(SESSION, submap_id, Cloud(body(place), KITTI), pose(float(place)), place)


def refused(worker: WorkerProcess) -> list[str]:
    """The operations whose end by this worker was refused, also where a server had ended its transaction before."""
    return [one["operation"] for one in worker.events if one.get("event") in ("result_refused", "end_refused")]


def overtake(home: Path, client: Client, quick: WorkerProcess, slow: WorkerProcess, stopped_s: float) -> float:
    """The slow worker, which waits at the gate, stands still in its job for `stopped_s`, the quick one does it.

    How long that took, seconds.
    """
    late = post(client, "c", 1)
    eventually(lambda: client.get_operation(late.name).state == "RUNNING", "the slow worker does not begin")
    with stopped(slow, home):
        stopped_at = time.monotonic()
        quick.send(signal.SIGCONT)
        done = client.wait(late)
        done_s = time.monotonic() - stopped_at
        threading.Event().wait(stopped_s - done_s)
        (home / "gate").touch()
    eventually(lambda: refused(slow), "its result is not refused")
    assert refused(slow) == [late.name.removeprefix("operations/")]
    assert (done.state, done.attempts) == ("DONE", 2)
    return done_s


@pytest.mark.parametrize("stopped_s", sizes("STOPPED_S", 1, 60))
def test_a_worker_that_was_stopped_beyond_its_lease_has_its_result_refused(folder, client, start_worker, stopped_s):
    lease_s, home, campaign = min(10.0, stopped_s), folder / "home", Campaign("P15", 1)
    quick = start_worker(lease_s=lease_s)
    for submap_id, place in (("a", 1), ("b", 2)):
        assert client.wait(post(client, submap_id, place)).state == "DONE"
    for _ in campaign:
        with stopped(quick, home):
            slow = start_worker(lease_s=lease_s, recogniser=MISTAKEN, fake_gate=home / "gate")
            done_s = overtake(home, client, quick, slow, stopped_s)
    loops = [(loop.query, loop.match, loop.state) for loop in client.loop_closures("maps/town")]
    assert loops == [(f"{SESSION}/submaps/c", f"{SESSION}/submaps/a", "ACCEPTED")]
    described = client.get_submap(f"{SESSION}/submaps/c", full=True)
    assert described.state == "DESCRIBED" and not np.allclose(described.descriptor, NOWHERE)
    found = survey(home)
    assert (found.problems, found.states) == ([], {"DESCRIBED": 3})
    campaign.publish(
        f"stopped for {stopped_s} s, its job done by another after {done_s:.1f} s, its late result refused"
    )
