"""A kernel whose intermediate code was packed runs, and can be called by one that is compiled afterwards."""

import os
import subprocess
import sys
from pathlib import Path

from tests.support.patience import PATIENCE_S

KERNEL = """
import numba

@numba.njit(cache=True)
def doubled(x):
    return 2.0 * x

doubled(1.0)
"""
CALLER = """
import numba
from kernel import doubled
from revisit.core.kernels.intermediate_code import pack_intermediate_code

print(sum(doubled.stats.cache_hits.values()), pack_intermediate_code(), pack_intermediate_code())

@numba.njit
def quadrupled(x):
    return doubled(doubled(x))

print(doubled(3.0), quadrupled(3.0))
"""


def test_a_packed_kernel_runs_and_can_still_be_compiled_into_another_one(tmp_path):
    (tmp_path / "kernel.py").write_text(KERNEL)
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{Path.cwd()}", "NUMBA_CACHE_DIR": str(tmp_path)}
    told = []
    for script in ("import kernel", CALLER):
        command = [sys.executable, "-c", script]
        ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
        told = ran.stdout.splitlines()
    assert told == ["1 1 0", "6.0 12.0"]
