"""Who compiles what, where several processes begin or one is alone (docs/decisions/0289)."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from revisit.service.adapters import warmup
from tests.support.patience import PATIENCE_S, eventually


class Companion:
    """Stands in for another process."""

    started: list[Companion] = []

    def __init__(self, command, **_) -> None:
        self.command, self.ended = command, False
        Companion.started.append(self)

    def kill(self) -> None:
        self.ended = True

    def wait(self) -> None:
        assert self.ended


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """The two folders that are locked; on a machine of two cores where nothing is compiled."""
    for name in ("kernels", "formats"):
        (tmp_path / name).mkdir()
        monkeypatch.setattr(warmup, name, SimpleNamespace(__file__=str(tmp_path / name / "__init__.py")))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(warmup, "_has_compiled", lambda _: True)
    monkeypatch.setattr(warmup.subprocess, "Popen", Companion)
    monkeypatch.setattr(Companion, "started", [])
    return tmp_path


@pytest.fixture
def done(monkeypatch):
    """The steps that were done, each with how many companions were at work."""
    done: list[tuple[int, int]] = []

    def step(number):
        return lambda: done.append((number, sum(not one.ended for one in Companion.started)))

    monkeypatch.setattr(warmup, "_steps", lambda _: tuple(step(number) for number in range(4)))
    return done


def taken(folder) -> int:
    """Lock a folder as another process does."""
    held = os.open(folder, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    return held


def test_a_process_that_is_alone_and_must_compile_has_a_companion(folders, done):
    warmup.warm_up(None)
    assert done == [(0, 0), (1, 0), (2, 1), (3, 1)]
    assert [one.ended for one in Companion.started] == [True]


def test_the_companion_ends_where_a_step_fails(folders, monkeypatch):
    def fail():
        raise ZeroDivisionError

    monkeypatch.setattr(warmup, "_steps", lambda _: (lambda: None, lambda: None, fail))
    with pytest.raises(ZeroDivisionError):
        warmup.warm_up(None)
    assert [one.ended for one in Companion.started] == [True]


@pytest.mark.parametrize("why", ["all is compiled", "one core", "another worker", "no process is free"])
def test_there_is_no_companion_where_none_is_needed_or_possible(folders, done, monkeypatch, why):
    def none_is_free(*_, **__):
        raise BlockingIOError

    held = None
    if why == "all is compiled":
        monkeypatch.setattr(warmup, "_has_compiled", lambda _: False)
    elif why == "one core":
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    elif why == "another worker":
        held = taken(folders / "formats")
    else:
        monkeypatch.setattr(warmup.subprocess, "Popen", none_is_free)
    warmup.warm_up(None)
    assert done == [(0, 0), (1, 0), (2, 0), (3, 0)]
    if held is not None:
        os.close(held)


def test_who_comes_second_begins_at_the_end_and_says_so(folders, done):
    held = taken(folders / "kernels")
    warmup.warm_up(None)
    assert done == [(3, 0), (2, 0), (1, 0), (0, 0)]
    os.close(held)


def test_a_companion_begins_at_the_end_and_will_end_with_its_worker(done, monkeypatch):
    bound: list[str] = []
    monkeypatch.setattr(warmup, "end_with_parent", lambda: bound.append("to its parent"))
    warmup.accompany(None)
    assert (done, bound) == ([(3, 0), (2, 0), (1, 0), (0, 0)], ["to its parent"])


PARENT = """
import subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
print(child.stdout.readline().decode().strip(), flush=True)
"""
CHILD = """
import os, time
from revisit.service.adapters.warmup import end_with_parent
end_with_parent()
print(os.getpid(), flush=True)
time.sleep(600)
"""


def test_a_process_ends_with_its_parent():
    command = [sys.executable, "-c", PARENT, CHILD]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    eventually(lambda: not _lives(int(ran.stdout)), "the companion lives on")


def _lives(pid: int) -> bool:
    """Whether a process is there and does something: one that has ended may not have been asked for its status yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_what_tells_whether_anything_is_compiled_is_among_the_first_steps():
    assert warmup._end_a_stream in warmup._steps(None)[: warmup.COMPILED_FIRST]
