"""What a worker loads, it holds for as long as it lives (docs/decisions/0289)."""

from __future__ import annotations

from revisit.service.engines.local.sqlite.migration import migrate
from tests.support.processes import WorkerProcess


def test_a_worker_loads_no_library_that_it_never_uses(tmp_path):
    migrate(tmp_path / "revisit.db")
    worker = WorkerProcess(tmp_path, recogniser="tests.support.lean_recogniser:load")  # starts, or tells what it loaded
    worker.close()
