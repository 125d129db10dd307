"""Which ends of a worker count against the job that it had."""

from __future__ import annotations

import signal

import pytest

from revisit.service.worker.exit_status import WorkerEnd, end_of, is_innocent, out_of_memory_kills, reason_of
from revisit.service.worker.heartbeat import ORPHANED, OVERTIME

OUTSIDE = [0, -signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP, ORPHANED, 74]
ITS_OWN = [-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE, OVERTIME, 1, 9]


@pytest.mark.parametrize("status", OUTSIDE)
def test_a_job_has_no_part_in_the_end_of_a_worker_that_somebody_ended(status):
    assert is_innocent(end_of(status), status, out_of_memory=0)


@pytest.mark.parametrize("status", ITS_OWN)
def test_a_crash_counts_against_the_job(status):
    assert not is_innocent(end_of(status), status, out_of_memory=0)


def test_a_worker_that_may_have_been_killed_for_want_of_memory_counts_against_its_job():
    status = -signal.SIGKILL
    assert not is_innocent(end_of(status), status, out_of_memory=1)
    assert is_innocent(end_of(-signal.SIGTERM), -signal.SIGTERM, out_of_memory=1)


def test_a_worker_that_was_killed_because_it_hung_counts_against_its_job():
    assert not is_innocent(WorkerEnd.SILENT, -signal.SIGKILL, out_of_memory=0)
    assert reason_of(WorkerEnd.SILENT, -signal.SIGKILL) == "its worker hung without a sign of life"


def test_the_kernels_count_is_read_where_there_is_one(tmp_path):
    (tmp_path / "vmstat").write_text("nr_free_pages 1\noom_kill 7\n")
    assert out_of_memory_kills(tmp_path / "vmstat") == 7
    (tmp_path / "vmstat").write_text("nr_free_pages 1\n")
    assert out_of_memory_kills(tmp_path / "vmstat") == 0
    assert out_of_memory_kills(tmp_path / "none") == 0
