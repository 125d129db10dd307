"""The gateway stays light: what only workers need is not imported."""

from __future__ import annotations

import subprocess
import sys

from tests.support.processes import ROOT

HEAVY = ("torch", "open3d", "cv2", "numba", "scipy", "matplotlib", "opentelemetry.sdk")


def test_the_gateway_imports_nothing_that_only_workers_need():
    script = (
        "import sys, revisit.core.index, revisit.service.gateway\n"
        "import revisit.service.rest.app, revisit.service.grpc.server\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


def test_a_start_with_nothing_to_migrate_does_not_load_what_migrates(tmp_path):
    script = (
        "import sys; from pathlib import Path\n"
        "from revisit.service.engines.local.sqlite.migration import migrate\n"
        "migrate(Path(sys.argv[1]) / 'revisit.db')\n"
        "print('alembic' in sys.modules)"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    runs = [subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True) for _ in range(2)]
    assert [run.stdout.strip() for run in runs] == ["True", "False"]
