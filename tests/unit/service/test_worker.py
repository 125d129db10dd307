"""When a worker makes room for a fresh one, and what it may take of its machine."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest
from structlog.testing import capture_logs

from revisit.service import ONE_THREAD
from revisit.service.worker import free_memory, heartbeat
from revisit.service.worker.heartbeat import WorkerIdentity, is_overtime
from revisit.service.worker.loop import IDLE_POLL_S, MOST_POLL_S, Worker, WorkerLimits, next_pause_s
from tests.support.patience import PATIENCE_S
from tests.support.processes import ROOT
from tests.support.service_world import TENANT, memory_world, open_session, submap

MIB = 2**20
GIB = 2**30


@pytest.fixture
async def world():
    made = memory_world()
    await open_session(made)
    for number in range(3):
        await made.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    yield made
    made.context.transactions.close()


def run_worker(world, limits, parent_pid=None):
    """Run a worker to its end; how many jobs are done then."""
    identity = WorkerIdentity("w1", "fake-1", parent_pid)
    worker = Worker(world.context, world.worker(), identity, threading.Event(), limits)
    thread = threading.Thread(target=worker.run)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    return world.context.transactions.read(lambda uow: uow.jobs.count(TENANT, state="DONE")).result()


async def test_a_worker_ends_after_its_number_of_jobs(world):
    assert run_worker(world, WorkerLimits(jobs=2, recycled_at_bytes=64 * GIB, job_timeout_s=60)) == 2


async def test_a_worker_whose_gateway_is_gone_begins_no_job(world, monkeypatch):
    # The heartbeat would end this process.
    monkeypatch.setattr(heartbeat, "POLL_EVERY_S", 3600.0)
    monkeypatch.setattr(heartbeat, "BEATS_PER_LEASE", 0.001)
    limits = WorkerLimits(jobs=2, recycled_at_bytes=64 * GIB, job_timeout_s=60)
    assert run_worker(world, limits, parent_pid=os.getpid()) == 0
    assert run_worker(world, limits, parent_pid=os.getppid()) == 2


async def test_a_worker_that_keeps_too_much_memory_ends_between_two_jobs(world):
    # Any process holds more than a byte; a worker that has done nothing yet is never ended for it.
    assert run_worker(world, WorkerLimits(jobs=3, recycled_at_bytes=1, job_timeout_s=60)) == 1


async def test_a_worker_that_ends_is_forgotten(world):
    run_worker(world, WorkerLimits(jobs=1, recycled_at_bytes=64 * GIB, job_timeout_s=60))
    assert world.context.transactions.read(lambda uow: uow.workers.alive(10_000)).result() == []


async def test_a_lease_is_said_to_be_lost_where_it_is_missing_at_two_beats(world):
    context, identity = world.context, WorkerIdentity("w", "fake-1", None)
    beating = heartbeat.Heartbeat(context.transactions, 10_000, world.worker(), identity, 60.0)
    ended, lost = world.claim("w"), world.claim("w")
    beating.hold(ended)
    world.worker().run(ended)
    with capture_logs() as logged:
        beating._beat()  # the job has ended, and the worker has yet to say so
        beating.hold(lost)
        beating._beat()
        world.worker().run(lost)
        beating._beat()
        assert logged == []
        beating._beat()
    assert [entry["event"] for entry in logged] == ["lease_lost"]
    assert logged[0]["operation"] == lost.job.operation_id


def test_a_confined_process_meets_a_memory_error_leaves_no_core_dump_and_goes_before_the_gateway():
    script = """
import os, resource
from pathlib import Path
import numpy as np
from revisit.service.worker.confinement import confine, resident_bytes
confine(300 * 2**20)
kept = np.ones(2**24)  # 128 MiB
assert 128 * 2**20 < resident_bytes() < 300 * 2**20
try:
    np.ones(2**25)  # 256 MiB more
except MemoryError:
    print("refused", resource.getrlimit(resource.RLIMIT_CORE), Path("/proc/self/oom_score_adj").read_text().strip(),
          os.nice(0))
"""
    command = [sys.executable, "-c", script]
    environment = {**os.environ, **ONE_THREAD}
    ran = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == f"refused (0, 0) 500 {max(5, os.nice(0))}"


KERNEL = """
import os
from numba import njit
from revisit.service.compiled_kernels import STARTED_ANEW, begin_anew_if_compiled

@njit(cache=True)
def double(number):
    return 2 * number

double(1)
print(os.getpid(), os.environ.pop(STARTED_ANEW, "first"), flush=True)
begin_anew_if_compiled()
"""


def test_a_worker_that_has_compiled_begins_anew_once_and_one_that_has_loaded_its_kernels_does_not(tmp_path):
    (tmp_path / "kernel.py").write_text(KERNEL)
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, str(tmp_path / "kernel.py")]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    (pid, first), (same_pid, again) = (line.split() for line in ran.stdout.splitlines())
    assert (pid, first, again) == (same_pid, "first", "1")


def test_memory_that_a_job_has_left_goes_back_while_some_of_its_blocks_are_kept():
    script = """
from revisit.service.large_blocks import SPARE_BYTES, return_free_memory
from revisit.service.worker.confinement import resident_bytes
blocks = [bytearray(60_000) for _ in range(4000)]  # 229 MiB, too small to be mapped by themselves
held, kept = resident_bytes(), blocks[::20]
del blocks
return_free_memory()
print(held - resident_bytes() > 150 * 2**20)
"""
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "True"


def test_free_memory_is_given_back_once_it_has_grown_and_once_nothing_is_to_do(monkeypatch):
    held, returned = [100 * MIB], []
    monkeypatch.setattr(free_memory, "resident_bytes", lambda: held[0])
    monkeypatch.setattr(free_memory, "return_free_memory", lambda: returned.append(held[0]))
    memory = free_memory.FreeMemory()
    memory.after_waiting(10.0)  # before the first job there is nothing to return
    assert returned == []
    for held[0] in (100 * MIB, 163 * MIB, 164 * MIB, 200 * MIB):
        memory.after_job()
    assert returned == [100 * MIB, 164 * MIB]
    for _ in range(40):
        memory.after_waiting(0.1)
    assert returned == [100 * MIB, 164 * MIB, 200 * MIB]


def test_a_process_of_the_service_starts_others_afresh_and_never_forks_itself():
    script = (
        "from revisit.service.__main__ import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "import multiprocessing\nprint(multiprocessing.get_start_method())"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "spawn"


@pytest.mark.parametrize(
    ("wall_s", "cpu_s", "over"),
    [
        (119.0, 119.0, False),
        (121.0, 121.0, True),
        (600.0, 60.0, False),  # others have nine tenths of its core
        (1300.0, 121.0, True),
        (121.0, 0.5, True),  # it waits for what does not come
        (1300.0, 90.0, True),  # however loaded the machine is, its submap is not kept for ever
    ],
)
def test_a_job_is_ended_by_the_work_that_it_does_and_not_by_the_load_of_the_machine(wall_s, cpu_s, over):
    assert is_overtime(wall_s, cpu_s, limit_s=120.0) is over


def test_a_worker_asks_a_shared_store_more_and_more_seldom_and_a_store_of_its_own_at_once():
    pauses = [IDLE_POLL_S]
    for _ in range(50):
        pauses.append(next_pause_s(pauses[-1], alone=False))
    assert pauses[1] > 0.7 * IDLE_POLL_S and 0.5 * MOST_POLL_S < max(pauses) <= MOST_POLL_S
    assert len(set(pauses)) > 40, "workers would ask all at the same moment"
    assert next_pause_s(MOST_POLL_S, alone=True) == IDLE_POLL_S
