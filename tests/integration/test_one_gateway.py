"""A data folder has one gateway."""

from __future__ import annotations

import subprocess
import sys
from contextlib import closing

from tests.support.patience import PATIENCE_S
from tests.support.processes import ROOT, ServiceProcess

TAKEN = 75


def test_a_second_gateway_on_one_data_folder_is_refused_and_the_first_goes_on(tmp_path):
    home = tmp_path / "home"
    with closing(ServiceProcess(home, workers=0)) as first:
        environment = {**first._environment}
        command = [sys.executable, "-m", "revisit.service", "serve"]
        second = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
        assert second.returncode == TAKEN
        assert f"is served by another gateway (process {first.pid})" in second.stderr
        first.kill()
        first.start()
        assert first.terminate()[0] == 0
