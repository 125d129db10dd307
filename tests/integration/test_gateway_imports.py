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
