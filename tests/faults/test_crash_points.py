"""Killed at every named point of the code and started again: nothing acknowledged is lost, nothing is doubled."""

from __future__ import annotations

import ast
import os
import signal
from collections import Counter
from pathlib import Path

import pytest

from revisit.service.failpoints import POINTS, arm
from tests.faults.drive import DEGENERATE, undisturbed
from tests.faults.history import History
from tests.faults.survey import opened, survey
from tests.support.forked import processes
from tests.support.made_database import made_database
from tests.support.patience import PATIENCE_S
from tests.support.records import TENANT
from tests.support.state import ON_POSTGRES, database_of

ROOT = Path(__file__).resolve().parents[2]
END = Counter({"DESCRIBED": 8, "FAILED": 1})
"""a, c, d, three windows of scans and two of the annex; the degenerate one."""


def _drive_into(home: Path, log: Path, armed: str) -> None:
    # What the drive logs about its failing job is no news.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    arm(armed)
    undisturbed(home, log)


def exit_status(home: Path, armed: str) -> int:
    """How a drive ends in a process of its own with `armed` points."""
    child = processes.Process(target=_drive_into, args=(home, home.parent / "log", armed))
    child.start()
    child.join(PATIENCE_S)
    status = child.exitcode
    child.close()
    assert status is not None
    return status


def history_of(home: Path) -> History:
    return History.parse((home.parent / "log").read_bytes())


def recovered(home: Path) -> tuple[Counter[str], list[str]]:
    """Look at the store as it was left, drive again after a reboot, look again: states and everything that is wrong."""
    wrong = survey(home).against(history_of(home)) if history_of(home).operations else []
    undisturbed(home, home.parent / "log", boot="boot-2")
    end = survey(home)
    return end.states, wrong + end.against(history_of(home))


@pytest.fixture
def home(folder) -> Path:
    """With a database of today's schema: kills of those that make one are in `test_killed_migration`."""
    if ON_POSTGRES:
        database_of(folder / "home")
    else:
        made_database(folder / "home" / "revisit.db")
    return folder / "home"


def calls_of_failpoint() -> list[str]:
    trees = [ast.parse(path.read_text()) for path in (ROOT / "service").rglob("*.py")]
    calls = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [ast.literal_eval(call.args[0]) for call in calls if ast.unparse(call.func) == "failpoint"]


def test_every_named_point_is_somewhere_in_the_code_and_every_point_in_the_code_has_a_name():
    assert set(calls_of_failpoint()) == set(POINTS)


def test_an_undisturbed_drive_leaves_nothing_to_complain_about(home):
    assert exit_status(home, "") == 0
    assert survey(home).against(history_of(home)) == []
    assert survey(home).states == END
    assert any(operation.key == f"submap/{DEGENERATE}" for operation in history_of(home).acknowledged())


def attempts(home: Path) -> dict[str, int]:
    """How often each operation was run."""
    with opened(home) as (uow, _):
        return {job.operation_id: job.attempts for job in uow.jobs.find(TENANT)}


def test_a_drive_that_is_repeated_runs_none_of_its_jobs_again(home):
    undisturbed(home, home.parent / "log")
    before = attempts(home)
    undisturbed(home, home.parent / "log", boot="boot-2")
    after = attempts(home)
    assert {operation: after[operation] for operation in before} == before


@pytest.mark.parametrize("point", POINTS)
def test_a_kill_at_any_point_loses_and_doubles_nothing(home, point):
    assert exit_status(home, f"{point}=kill") == -signal.SIGKILL
    assert recovered(home) == (END, [])


@pytest.mark.parametrize("point", ["commit.after", "ingest.after_commit", "delete.after_rows", "merge.after_loops"])
def test_a_kill_in_the_midst_of_the_drive_loses_and_doubles_nothing(home, point):
    assert exit_status(home, f"{point}=kill@2") in (-signal.SIGKILL, 0)
    assert recovered(home) == (END, [])


@pytest.mark.slow
@pytest.mark.parametrize("point", POINTS)
def test_a_kill_at_every_visit_of_any_point_loses_and_doubles_nothing(folder, point):
    """Up to the visit at which the drive gets through."""
    for visit in range(1, 200):
        home = folder / str(visit) / "home"
        home.parent.mkdir()
        if ON_POSTGRES:
            database_of(home)
        status = exit_status(home, f"{point}=kill@{visit}")
        assert status in (-signal.SIGKILL, 0)
        assert recovered(home) == (END, []), visit
        if status == 0:
            assert visit > 1
            return
    raise AssertionError(f"the drive still reaches {point}")
