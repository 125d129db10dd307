"""The examples of the documentation, against the real service and the real method: the yard is recognised."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from revisit.core.geometry import se3
from tests.support.processes import ServiceProcess

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A service with one worker, which describes submaps by the method itself."""
    home = tmp_path_factory.mktemp("yard")
    method = "revisit.service.adapters.core_recogniser:load_recogniser"
    service = ServiceProcess(home, recogniser=method)
    yield service
    service.close()


def loops_printed(example, **environment):
    """(query, match) -> T_match_query, as the example prints them."""
    command = [sys.executable, ROOT / "docs" / "examples" / example]
    variables = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    result = subprocess.run(command, capture_output=True, text=True, timeout=240, check=True, env=variables)
    found = re.findall(r"^(\S+) is where (\S+) was, score 1.00\n(\[\[[^a-z]+\]\])", result.stdout, re.MULTILINE)
    return {(query, match): numbers(rows) for query, match, rows in found}


def numbers(rows):
    return np.array(re.findall(r"-?\d+\.\d*", rows), float).reshape(4, 4)


def test_the_rest_example_finds_how_the_robot_stood_on_the_second_day(running):
    (T_match_query,) = loops_printed("rest_client.py", REVISIT_HTTP=running.url).values()
    assert T_match_query == pytest.approx(se3.from_yaw(np.radians(40.0), (3.0, 0.0, 0.0)), abs=0.05)


def test_the_grpc_example_finds_every_pair_of_the_two_drives(running):
    found = loops_printed("grpc_client.py", REVISIT_GRPC=running.grpc_target)
    assert len(found) == 4
    T_yard_monday, T_yard_tuesday = se3.from_yaw(0.0, (-5.0, 0.0, 0.0)), se3.from_yaw(2.0, (4.0, -3.0, 0.0))
    # The frame of a submap is that of its middle scan, here metres 5 and 8 of the drive.
    middle = {"scans-1-11": se3.from_yaw(0.0, (5.0, 0.0, 0.0)), "scans-6-12": se3.from_yaw(0.0, (8.0, 0.0, 0.0))}
    for (query, match), T_match_query in found.items():
        T_yard_query = T_yard_tuesday @ middle[query.split("/")[-1]]
        T_yard_match = T_yard_monday @ middle[match.split("/")[-1]]
        assert T_match_query == pytest.approx(se3.inverse(T_yard_match) @ T_yard_query, abs=0.05)
