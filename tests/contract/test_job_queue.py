"""The contract of JobQueue: at least one run, at most one effect."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.service.domain.errors import StaleLease
from revisit.service.domain.identity import TenantId
from revisit.service.engines.leased_jobs import MOST_FORGIVEN
from tests.support.records import TENANT, a_job

LEASE_MS = 10_000


@pytest.fixture
def queue(write, clock):
    def at(ms):
        clock.ms, clock.day_ns = ms, 7

    class Queue:
        def enqueue(self, *ids, **fields):
            for operation_id in ids:
                write(lambda uow, operation_id=operation_id: uow.queue.enqueue(a_job(operation_id, **fields)))

        def claim(self, ms=0, owner="w1"):
            at(ms)
            return write(lambda uow: uow.queue.claim(owner))

        def fail(self, lease, ms=0, retry=True, innocent=False):
            how = {"retry": retry, "innocent": innocent}
            at(ms)
            return write(lambda uow: uow.queue.fail(lease, "INTERNAL", "why", **how))

        def put_back(self, lease, *behind, ms=0):
            at(ms)
            write(lambda uow: uow.queue.put_back(lease, behind))

        def under_way(self, *ids, ms=0):
            at(ms)
            return write(lambda uow: uow.queue.under_way(TENANT, ids))

        def complete(self, lease, ms=0):
            at(ms)
            write(lambda uow: uow.queue.complete(lease, {"ok": True}))

        def release(self, owner, ms=0, **why):
            at(ms)
            return write(lambda uow: uow.queue.release(owner, why.pop("reason", "it fell over"), **why))

        def forgive(self, family="w"):
            return write(lambda uow: uow.queue.forgive(family))

        def extend(self, lease, ms):
            at(ms)
            write(lambda uow: uow.queue.extend(lease))

        def fail_exhausted_jobs(self, ms):
            at(ms)
            return write(lambda uow: uow.queue.fail_exhausted_jobs())

    return Queue()


def stored(read, operation_id="op-1"):
    return read(lambda uow: uow.jobs.get(TENANT, operation_id))


def test_jobs_are_claimed_oldest_first_and_once(queue):
    queue.enqueue("op-1", "op-2")
    assert [queue.claim().job.operation_id for _ in range(2)] == ["op-1", "op-2"]
    assert queue.claim() is None


def test_a_job_for_which_a_client_waits_goes_before_older_ones_and_one_for_which_nobody_does_after_all(queue, write):
    for operation_id, priority in (("recall", 2), ("op-1", 1), ("search", 0)):
        write(lambda uow, job=a_job(operation_id, priority=priority): uow.queue.enqueue(job))
    assert [queue.claim().job.operation_id for _ in range(3)] == ["search", "op-1", "recall"]


def test_queries_that_ended_long_ago_are_forgotten_and_nothing_else(queue, write, read, clock):
    ends = {"older": 10, "old": 20, "recent": 30}
    for operation_id, finished_at_ns in ends.items():
        queue.enqueue(operation_id, priority=0, tenant=f"of-{operation_id}")
        lease = queue.claim()
        clock.day_ns = finished_at_ns
        write(lambda uow, lease=lease: uow.queue.complete(lease, {}))
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
    assert [queue.claim().job.operation_id for _ in range(7)] == ["a0", "b0", "c0", "a1", "b1", "a2", "a3"]


def test_tenants_share_the_time_of_the_workers_not_their_number_of_jobs(queue):
    queue.enqueue(*(f"a{number}" for number in range(5)), tenant="anna")
    queue.enqueue(*(f"b{number}" for number in range(9)), tenant="bert")
    ms, order = 0, []
    while len(order) < 8:
        lease = queue.claim(ms)
        order.append(lease.job.operation_id)
        ms += 4_000 if lease.job.tenant == "anna" else 1_000
        queue.complete(lease, ms)
    assert order == ["a0", "b0", "b1", "b2", "b3", "a1", "b4", "b5"]


def test_a_tenant_that_had_nothing_to_do_has_saved_up_no_claim(queue):
    queue.enqueue("a0", "a1", "a2", tenant="anna")
    for ms in (0, 60_000):
        queue.complete(queue.claim(ms), ms + 60_000)
    queue.enqueue("b0", "b1", "b2", tenant="bert")
    b0 = queue.claim(120_000)
    queue.complete(b0, 180_001)
    assert (b0.job.operation_id, queue.claim(180_001).job.operation_id) == ("b0", "a2")


TIMEOUT_MS = 120_000


def test_jobs_that_run_out_of_time_again_and_again_keep_another_tenant_waiting_for_one_of_them_at_most(queue):
    queue.enqueue("a0", "a1", "a2", tenant="anna")
    ms, waited_ms = 0, []
    for round_number in range(6):
        # Bert asks in the middle of the run; the worker that it ends is replaced by one that remembers nothing.
        hopeless = queue.claim(ms, owner=f"w{round_number}")
        assert hopeless.job.tenant == "anna"
        queue.enqueue(f"b{round_number}", tenant="bert")
        asked_ms, ms = ms + TIMEOUT_MS // 2, ms + TIMEOUT_MS
        queue.fail(hopeless, ms)
        again = queue.claim(ms, owner=f"v{round_number}")
        assert again.job.tenant == "bert"
        waited_ms.append(ms - asked_ms)
        ms += 1_000
        queue.complete(again, ms)
    assert max(waited_ms) <= TIMEOUT_MS


def test_a_job_that_ran_out_of_time_lets_the_others_of_its_tenant_go_first(queue):
    queue.enqueue("a0", "a1", "a2", tenant="anna")
    queue.fail(queue.claim(0), TIMEOUT_MS)
    a1 = queue.claim(TIMEOUT_MS)
    queue.complete(a1, TIMEOUT_MS + 1_000)
    assert (a1.job.operation_id, queue.claim(TIMEOUT_MS + 1_000).job.operation_id) == ("a1", "a2")


def test_the_time_of_a_worker_that_died_is_paid_by_its_tenant(queue):
    queue.enqueue("a0", "a1", tenant="anna")
    queue.claim(0, owner="dead")
    queue.release("dead", 50_000)
    queue.enqueue("b0", "b1", tenant="bert")
    for number in range(2):
        lease = queue.claim(50_000 + number * 1_000)
        assert lease.job.operation_id == f"b{number}"
        queue.complete(lease, 51_000 + number * 1_000)


def test_a_job_that_a_dead_worker_left_is_claimed_in_its_tenants_turn(queue):
    queue.enqueue("b0", tenant="bert")
    assert queue.claim().job.operation_id == "b0"
    queue.enqueue("a0", "a1", tenant="anna")
    assert [queue.claim(ms=LEASE_MS).job.operation_id for _ in range(3)] == ["a0", "a1", "b0"]


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
        uow.queue.complete(late, {})

    with pytest.raises(StaleLease):
        write(result_with_effect)
    assert stored(read, "effect") is None


def test_a_claim_that_a_crash_undid_leaves_no_lease_that_is_given_out_again(queue, write):
    queue.enqueue("op-1")
    undone = []

    def crash(uow):
        undone.append(uow.queue.claim("w1"))
        raise ConnectionError("the host is gone")

    with pytest.raises(ConnectionError):
        write(crash)
    lease = queue.claim(owner="w2")
    assert (lease.job.attempts, undone[0].job.attempts) == (1, 1)
    with pytest.raises(StaleLease):
        queue.complete(undone[0])
    queue.complete(lease)


def test_a_failed_run_goes_back_after_a_pause_until_the_attempts_are_used_up(queue, read):
    queue.enqueue("op-1")
    assert queue.fail(queue.claim(ms=0), ms=0) is False
    assert queue.claim(ms=499) is None
    assert queue.fail(queue.claim(ms=500), ms=500) is False
    assert queue.claim(ms=1_499) is None
    assert queue.fail(queue.claim(ms=1_500), ms=1_500) is True
    assert (stored(read).state, stored(read).attempts, stored(read).failure_message) == ("FAILED", 3, "why")
    assert queue.claim(ms=10 * LEASE_MS) is None


def test_a_failure_that_the_job_has_no_part_in_does_not_count_up_to_a_bound(queue, read):
    queue.enqueue("op-1")
    ms, runs = 0, 1
    while not queue.fail(queue.claim(ms), ms=ms, innocent=True):
        ms, runs = ms + 60_000, runs + 1
    assert (runs, stored(read).attempts, stored(read).forgiven) == (MOST_FORGIVEN + 3, MOST_FORGIVEN + 3, MOST_FORGIVEN)


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
    assert queue.release("dead", 100) == 1
    assert queue.claim(ms=100, owner="living").job.operation_id == "op-3"
    assert queue.claim(ms=599, owner="living") is None
    again = queue.claim(ms=600, owner="living").job
    assert (again.operation_id, again.attempts, again.failure_message) == ("op-1", 2, None)


def test_a_late_result_of_a_worker_that_was_given_up_is_refused(queue, write):
    queue.enqueue("op-1")
    late = queue.claim(owner="given up")
    queue.release("given up", reason="it hung")
    with pytest.raises(StaleLease):
        queue.complete(late)


def test_a_job_whose_last_worker_died_is_buried_with_the_reason(queue, write, read):
    queue.enqueue("op-1")
    for run in range(3):
        queue.claim(ms=run * LEASE_MS, owner=f"w{run}")
        queue.release(f"w{run}", run * LEASE_MS, reason=f"fall {run} broke it")
    assert queue.claim(ms=3 * LEASE_MS) is None
    assert [job.operation_id for job in queue.fail_exhausted_jobs(ms=3 * LEASE_MS)] == ["op-1"]
    message = "no worker survived the job: 3 attempts, the last one ended because fall 2 broke it"
    assert (stored(read).state, stored(read).failure_message) == ("FAILED", message)


def test_runs_that_ended_from_outside_do_not_count_against_their_job(queue, read):
    queue.enqueue("op-1")
    ms = 0
    for run in range(10):
        queue.claim(ms, owner=f"w{run}")
        queue.release(f"w{run}", ms, innocent=True)
        ms += 10_000
    assert queue.fail_exhausted_jobs(ms) == []
    lease = queue.claim(ms)
    assert (lease.job.attempts, lease.job.counted_attempts) == (11, 1)
    queue.complete(lease, ms)
    assert (stored(read).state, stored(read).failure_message) == ("DONE", None)


def test_a_job_that_ends_its_worker_every_time_is_buried_even_where_it_looks_like_from_outside(queue, read):
    queue.enqueue("op-1")
    ms, runs = 0, 0
    while stored(read).state != "FAILED":
        assert queue.claim(ms, owner=f"w{runs}") is not None
        queue.release(f"w{runs}", ms, innocent=True)
        ms, runs = ms + 60_000, runs + 1
        queue.fail_exhausted_jobs(ms)
    assert (runs, stored(read).attempts) == (MOST_FORGIVEN + 3, MOST_FORGIVEN + 3)


def test_a_service_that_starts_again_forgives_the_runs_that_were_under_way_once(queue, read):
    queue.enqueue("op-1", "op-2")
    queue.claim(0)
    assert [queue.forgive(), queue.forgive()] == [1, 0]
    assert (stored(read).attempts, stored(read).counted_attempts) == (1, 0)
    assert stored(read, "op-2").forgiven == 0
    queue.claim(1)
    for run in range(1, 4):
        assert queue.claim(run * LEASE_MS).job.operation_id == "op-1"
    assert "op-1" in {job.operation_id for job in queue.fail_exhausted_jobs(4 * LEASE_MS)}


def test_a_run_that_was_forgiven_can_still_end_well(queue, read):
    queue.enqueue("op-1")
    lease = queue.claim()
    queue.forgive()
    queue.complete(lease)
    assert (stored(read).state, stored(read).failure_message) == ("DONE", None)


def test_a_gateway_that_starts_forgives_its_own_workers_only(queue, read):
    queue.enqueue("op-1", "op-2")
    queue.claim(owner="worker-here-1")
    queue.claim(owner="worker-there-1")
    assert queue.forgive("worker-here-") == 1
    assert [stored(read, operation_id).forgiven for operation_id in ("op-1", "op-2")] == [1, 0]


def test_the_time_of_a_tenant_is_that_of_all_workers_and_outlives_them(queue):
    queue.enqueue(*(f"a{number}" for number in range(4)), tenant="anna")
    leases = [queue.claim(0, owner=f"w{number}") for number in range(3)]
    for number, lease in enumerate(leases):
        queue.complete(lease, 20_000)
        queue.release(f"w{number}", 20_000)
    queue.enqueue(*(f"b{number}" for number in range(5)), tenant="bert")
    for number in range(5):  # until Bert has had as much: he was lifted to where Anna's last job began
        lease = queue.claim(20_000 + number * 10_000, owner="w9")
        assert lease.job.operation_id == f"b{number}"
        queue.complete(lease, 30_000 + number * 10_000)


def test_what_was_given_up_is_not_forgiven(queue, read):
    queue.enqueue("op-1", max_attempts=1)
    queue.claim(owner="dead")
    queue.release("dead", reason="it crashed")
    assert queue.forgive() == 0
    assert [job.failure_message for job in queue.fail_exhausted_jobs(1)] == [
        "no worker survived the job: 1 attempts, the last one ended because it crashed"
    ]


def test_a_run_tells_how_far_it_is_and_learns_that_it_is_to_end(queue, write, read):
    queue.enqueue("op-1")
    lease = queue.claim()
    told = {"stage": "VERIFY_LOOPS", "done": 3, "total": 9}
    assert write(lambda uow: uow.queue.report(lease, told)) is True
    job = read(lambda uow: uow.jobs.get(TENANT, "op-1"))
    assert job.progress == told
    write(lambda uow: uow.jobs.replace(replace(job, cancel_requested=True)))
    assert write(lambda uow: uow.queue.report(lease, told)) is False
    later = queue.claim(LEASE_MS + 1, owner="w2")
    with pytest.raises(StaleLease):
        write(lambda uow: uow.queue.report(lease, told))
    assert write(lambda uow: uow.queue.report(later, told)) is False


def test_of_the_operations_that_somebody_waits_for_those_are_told_that_wait_or_run(write, read):
    def fill(uow):
        for number in range(4):
            uow.jobs.add(a_job(f"op-{number}", state=("QUEUED", "RUNNING", "DONE", "FAILED")[number]))
        uow.jobs.add(a_job("foreign", tenant=TenantId("other")))

    write(fill)
    asked = {"op-0", "op-1", "op-2", "op-3", "foreign", "none"}
    assert read(lambda uow: uow.jobs.unfinished(TENANT, asked)) == {"op-0", "op-1"}
    assert read(lambda uow: uow.jobs.unfinished(TENANT, {"op-1"})) == {"op-1"}


def test_a_job_is_under_way_from_its_claim_to_its_end_or_to_the_end_of_its_lease(queue):
    queue.enqueue("op-1", "op-2", "op-3")
    assert queue.under_way("op-1", "op-2") == frozenset()
    first, _ = queue.claim(ms=5), queue.claim(ms=7)
    asked = "op-1", "op-2", "op-3", "unknown"
    assert queue.under_way(*asked, ms=4 + LEASE_MS) == {"op-1", "op-2"}
    assert queue.under_way(*asked, ms=5 + LEASE_MS) == {"op-2"}
    queue.extend(first, ms=6 + LEASE_MS)
    assert queue.under_way(*asked, ms=7 + LEASE_MS) == {"op-1"}
    queue.complete(first, ms=8 + LEASE_MS)
    assert queue.under_way(*asked, ms=8 + LEASE_MS) == frozenset()


def test_a_run_that_waits_for_another_job_is_no_attempt_and_comes_again_in_a_moment_but_not_before_that(queue, read):
    queue.enqueue("op-1", "op-2")
    hung, waiting = queue.claim(ms=0), queue.claim(ms=0, owner="w2")
    queue.put_back(waiting, "op-1", ms=5_000)
    assert stored(read, "op-2").attempts == 0
    assert queue.claim(ms=5_499) is None
    waiting = queue.claim(ms=5_500)
    queue.fail(hung, ms=6_000)
    queue.put_back(waiting, "op-1", ms=6_000)
    assert queue.claim(ms=11_999) is None
    assert [queue.claim(ms=12_000).job.operation_id for _ in range(2)] == ["op-1", "op-2"]


def test_a_late_run_puts_nothing_back(queue, read):
    queue.enqueue("op-1")
    late, newest = queue.claim(ms=0), queue.claim(ms=LEASE_MS, owner="w2")
    with pytest.raises(StaleLease):
        queue.put_back(late, ms=LEASE_MS)
    assert stored(read).lease_id == newest.job.lease_id
