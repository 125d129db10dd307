"""The contract of JobQueue: at least one run, at most one effect."""

from __future__ import annotations

import pytest

from revisit.service.application.contract.clock import Instant
from revisit.service.application.contract.errors import StaleLease
from tests.support.records import TENANT, a_job

LEASE_MS = 10_000


def at(ms: int, epoch: str = "boot") -> Instant:
    return Instant(epoch, ms)


@pytest.fixture
def queue(write):
    class Queue:
        def enqueue(self, *ids, **fields):
            for operation_id in ids:
                write(lambda uow, operation_id=operation_id: uow.queue.enqueue(a_job(operation_id, **fields)))

        def claim(self, ms=0, owner="w1", epoch="boot", after=""):
            return write(lambda uow: uow.queue.claim(owner, at(ms, epoch), after))

        def fail(self, lease, ms=0, retry=True):
            return write(lambda uow: uow.queue.fail(lease, "INTERNAL", "why", at(ms), 7, retry=retry))

        def complete(self, lease):
            write(lambda uow: uow.queue.complete(lease, {"ok": True}, 7))

        def extend(self, lease, ms):
            write(lambda uow: uow.queue.extend(lease, at(ms)))

        def fail_exhausted_jobs(self, ms):
            return write(lambda uow: uow.queue.fail_exhausted_jobs(at(ms), 7))

    return Queue()


def stored(read, operation_id="op-1"):
    return read(lambda uow: uow.jobs.get(TENANT, operation_id))


def test_jobs_are_claimed_oldest_first_and_once(queue):
    queue.enqueue("op-1", "op-2")
    assert [queue.claim().job.operation_id for _ in range(2)] == ["op-1", "op-2"]
    assert queue.claim() is None


def test_a_job_for_which_a_client_waits_goes_before_older_ones(queue, write):
    queue.enqueue("op-1")
    write(lambda uow: uow.queue.enqueue(a_job("search", priority=0)))
    assert [queue.claim().job.operation_id for _ in range(2)] == ["search", "op-1"]


def test_queries_that_ended_long_ago_are_forgotten_and_nothing_else(queue, write, read):
    ends = {"older": 10, "old": 20, "recent": 30}
    for operation_id, finished_at_ns in ends.items():
        queue.enqueue(operation_id, priority=0, tenant=f"of-{operation_id}")
        lease = queue.claim()
        write(lambda uow, lease=lease, at=finished_at_ns: uow.queue.complete(lease, {}, at))
    queue.enqueue("described", priority=1)
    queue.complete(queue.claim())  # ended before all others, but belongs to a submap
    queue.enqueue("waiting", priority=0)
    assert write(lambda uow: uow.jobs.forget_answers(30, 1)) == 1
    assert read(lambda uow: {job.operation_id for job in uow.jobs.of_all_tenants()}) == {
        "old", "recent", "described", "waiting"
    }  # fmt: skip
    assert write(lambda uow: uow.jobs.forget_answers(30, 10)) == 1
    assert write(lambda uow: uow.jobs.forget_answers(30, 10)) == 0
    assert read(lambda uow: {job.operation_id for job in uow.jobs.of_all_tenants()}) == {
        "recent", "described", "waiting"
    }  # fmt: skip


def test_tenants_take_turns_however_many_jobs_one_of_them_has(queue):
    queue.enqueue(*(f"a{number}" for number in range(50)), tenant="anna")
    queue.enqueue("b0", "b1", tenant="bert")
    queue.enqueue("c0", tenant="carl", priority=0)
    order, last = [], ""
    for _ in range(7):
        job = queue.claim(after=last).job
        order.append(job.operation_id)
        last = job.tenant
    assert order == ["a0", "b0", "c0", "a1", "b1", "a2", "a3"]


def test_a_job_that_a_dead_worker_left_is_claimed_in_its_tenants_turn(queue):
    queue.enqueue("b0", tenant="bert")
    assert queue.claim(after="anna").job.operation_id == "b0"
    queue.enqueue("a0", "a1", tenant="anna")
    assert queue.claim(ms=LEASE_MS, after="anna").job.operation_id == "b0"
    assert queue.claim(ms=LEASE_MS, after="bert").job.operation_id == "a0"


def test_the_attempt_is_counted_before_the_run(queue, read):
    queue.enqueue("op-1")
    queue.claim()
    assert (stored(read).attempts, stored(read).state) == (1, "RUNNING")


def test_a_completed_job_keeps_its_result_and_is_not_claimed_again(queue, read):
    queue.enqueue("op-1")
    queue.complete(queue.claim())
    assert (stored(read).state, stored(read).result, stored(read).finished_at_ns) == ("DONE", {"ok": True}, 7)
    assert queue.claim(ms=10 * LEASE_MS) is None


def test_a_lease_that_runs_out_is_claimed_by_another_and_a_heartbeat_prevents_that(queue):
    queue.enqueue("op-1")
    lease = queue.claim(ms=0)
    assert queue.claim(ms=LEASE_MS - 1, owner="w2") is None
    queue.extend(lease, ms=LEASE_MS - 1)
    assert queue.claim(ms=LEASE_MS, owner="w2") is None
    assert queue.claim(ms=2 * LEASE_MS, owner="w2").job.attempts == 2


def test_a_late_result_is_refused_by_its_token(queue, read):
    queue.enqueue("op-1")
    late = queue.claim(ms=0)
    current = queue.claim(ms=LEASE_MS, owner="w2")
    for act in (
        lambda: queue.complete(late),
        lambda: queue.extend(late, ms=LEASE_MS),
        lambda: queue.fail(late),
    ):
        with pytest.raises(StaleLease):
            act()
    queue.complete(current)
    with pytest.raises(StaleLease):
        queue.complete(current)
    assert stored(read).lease_owner == "w2"


def test_a_refused_result_undoes_what_came_with_it(queue, write, read):
    queue.enqueue("op-1")
    late = queue.claim(ms=0)
    queue.claim(ms=LEASE_MS)

    def result_with_effect(uow):
        uow.queue.enqueue(a_job("effect"))
        uow.queue.complete(late, {}, 7)

    with pytest.raises(StaleLease):
        write(result_with_effect)
    assert stored(read, "effect") is None


def test_leases_of_another_boot_have_run_out(queue):
    queue.enqueue("op-1")
    queue.claim(ms=5_000_000, epoch="boot")
    assert queue.claim(ms=0, epoch="next boot").job.attempts == 2


def test_a_failed_run_goes_back_after_a_pause_until_the_attempts_are_used_up(queue, read):
    queue.enqueue("op-1")
    assert queue.fail(queue.claim(ms=0), ms=0) is False
    assert queue.claim(ms=499) is None
    assert queue.fail(queue.claim(ms=500), ms=500) is False
    assert queue.claim(ms=1_499) is None
    assert queue.fail(queue.claim(ms=1_500), ms=1_500) is True
    assert (stored(read).state, stored(read).attempts, stored(read).failure_message) == ("FAILED", 3, "why")
    assert queue.claim(ms=10 * LEASE_MS) is None


def test_a_failure_that_no_retry_can_mend_is_final_at_once(queue, read):
    queue.enqueue("op-1")
    assert queue.fail(queue.claim(), retry=False) is True
    assert (stored(read).state, stored(read).attempts) == ("FAILED", 1)


def test_a_job_whose_workers_keep_dying_is_buried_after_its_last_attempt(queue, read):
    queue.enqueue("op-1", "op-2")
    for run in range(3):
        assert queue.claim(ms=run * LEASE_MS, owner=f"w{run}").job.operation_id == "op-1"
    assert queue.fail_exhausted_jobs(ms=3 * LEASE_MS - 1) == []
    assert [job.operation_id for job in queue.fail_exhausted_jobs(ms=3 * LEASE_MS)] == ["op-1"]
    assert stored(read).state == "FAILED"
    assert queue.claim(ms=3 * LEASE_MS).job.operation_id == "op-2"


def test_the_job_of_a_dead_worker_goes_back_at_once_behind_the_others_for_a_pause(queue, write):
    queue.enqueue("op-1", "op-2", "op-3")
    queue.claim(owner="dead")
    queue.claim(owner="living")
    assert write(lambda uow: uow.queue.release("dead", at(100), "it fell over")) == 1
    assert queue.claim(ms=100, owner="living").job.operation_id == "op-3"
    assert queue.claim(ms=599, owner="living") is None
    again = queue.claim(ms=600, owner="living").job
    assert (again.operation_id, again.attempts, again.failure_message) == ("op-1", 2, None)


def test_a_late_result_of_a_worker_that_was_given_up_is_refused(queue, write):
    queue.enqueue("op-1")
    late = queue.claim(owner="given up")
    write(lambda uow: uow.queue.release("given up", at(0), "it hung"))
    with pytest.raises(StaleLease):
        queue.complete(late)


def test_a_job_whose_last_worker_died_is_buried_with_the_reason(queue, write, read):
    queue.enqueue("op-1")
    for run in range(3):
        queue.claim(ms=run * LEASE_MS, owner=f"w{run}")
        write(lambda uow, run=run: uow.queue.release(f"w{run}", at(run * LEASE_MS), f"fall {run} broke it"))
    assert queue.claim(ms=3 * LEASE_MS) is None
    assert [job.operation_id for job in queue.fail_exhausted_jobs(ms=3 * LEASE_MS)] == ["op-1"]
    message = "no worker survived the job: 3 attempts, the last one ended because fall 2 broke it"
    assert (stored(read).state, stored(read).failure_message) == ("FAILED", message)
