from __future__ import annotations

import errno
import re
import subprocess
import sys
from pathlib import Path

import pytest

from revisit.service import failpoints
from revisit.service.failpoints import FailpointReached, arm, failpoint
from tests.support.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def nothing_armed():
    yield
    arm("")


def test_nothing_happens_at_a_point_that_is_not_armed():
    arm("commit.before=raise")
    failpoint("commit.after")


def test_a_point_with_a_number_acts_when_it_is_reached_for_that_time_only():
    arm("commit.before=raise@3")
    reached = []
    for _ in range(5):
        try:
            failpoint("commit.before")
            reached.append("passed")
        except FailpointReached:
            reached.append("raised")
    assert reached == ["passed", "passed", "raised", "passed", "passed"]


def test_a_point_without_a_number_acts_every_time():
    arm(" commit.before=raise , blob.before_sync=raise")
    for _ in range(2):
        with pytest.raises(FailpointReached, match=r"commit\.before"):
            failpoint("commit.before")


@pytest.mark.parametrize(("action", "number"), [("enospc", errno.ENOSPC), ("eio", errno.EIO)])
def test_a_disk_fault_has_the_number_that_the_kernel_would_give(action, number):
    arm(f"blob.before_sync={action}")
    with pytest.raises(OSError) as caught:
        failpoint("blob.before_sync")
    assert caught.value.errno == number


def test_arming_again_disarms_what_was_armed_before():
    arm("commit.before=raise")
    arm("commit.after=raise")
    failpoint("commit.before")


@pytest.mark.parametrize(("action", "status"), [("kill", -9), ("exit", failpoints.EXIT_STATUS)])
def test_the_process_ends_at_the_point(action, status):
    program = (
        f"from revisit.service.failpoints import *; arm('commit.after={action}'); failpoint('commit.after'); print(1)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, timeout=PATIENCE_S, check=False
    )
    assert (ended.returncode, ended.stdout) == (status, b"")


@pytest.mark.parametrize(
    ("specification", "message"),
    [
        ("ingest.nowhere=kill", "there is no failpoint 'ingest.nowhere'; there are blob.before_sync"),
        ("commit.after=explode", "a failpoint cannot 'explode'; it can kill"),
        ("commit.after", "'commit.after' is not of the form"),
        ("commit.after=kill@0", "'commit.after=kill@0' is not of the form"),
    ],
)
def test_what_does_not_exist_cannot_be_armed(specification, message):
    arm("commit.before=raise")
    with pytest.raises(ValueError, match=re.escape(message)):
        arm(specification)
    with pytest.raises(FailpointReached):
        failpoint("commit.before")


def test_the_service_does_not_start_with_a_failpoint_that_does_not_exist(tmp_path):
    environment = {"REVISIT_FOR_TESTS": '{"fail": "nowhere=kill"}', "REVISIT_HOME": str(tmp_path / "home"), "PATH": ""}
    command = [sys.executable, "-m", "revisit.service", "serve"]
    ended = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert ended.returncode == 78
    assert "REVISIT_FOR_TESTS: there is no failpoint 'nowhere'" in ended.stderr
    assert not (tmp_path / "home").exists()
