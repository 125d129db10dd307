"""A robot's own folder may hold packages named as ours or our libraries: the service takes none of them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from revisit.service import python_subprocess
from tests.support.processes import ROOT, ServiceProcess

FOREIGN = ("revisit", "numpy", "numba", "json")


class ServiceInAFolder(ServiceProcess):
    """The service as `revisit serve` starts it, in a folder of somebody else."""

    python = (sys.executable, "-P")

    def __init__(self, folder, home):
        self.folder = folder
        super().__init__(home)


@pytest.fixture
def foreign(tmp_path):
    folder = tmp_path / "robot"
    for name in FOREIGN:
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text('raise ImportError("a package of the robot, and none of Revisit")\n')
    return folder


def test_workers_start_in_a_folder_with_foreign_packages_of_the_same_names(foreign, tmp_path):
    service = ServiceInAFolder(foreign, tmp_path / "data")
    try:
        service.wait_for("worker_ready")
        assert "worker_ended" not in {entry.get("event") for entry in service.events}
    finally:
        service.close()


@pytest.mark.parametrize("path", ["", os.pathsep, f"{os.pathsep}/opt/ros"])
def test_an_empty_place_in_the_search_path_is_not_the_working_directory(path, foreign, monkeypatch):
    # PYTHONPATH=$PYTHONPATH:/opt/ros leaves one where the variable was empty.
    monkeypatch.setenv("PYTHONPATH", path)
    code = "import json, numpy, revisit; print(revisit.__file__)"
    command, environment = python_subprocess.command("-c", code), python_subprocess.environment()
    done = subprocess.run(command, cwd=foreign, env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == (str(ROOT / "revisit/__init__.py"), "")
