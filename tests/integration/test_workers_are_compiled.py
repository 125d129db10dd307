"""A worker that takes jobs has compiled, or loaded, whatever it will ask for: no job pays for that, nor its memory."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from revisit.core import kernels
from tests.support.patience import PATIENCE_S

LIFE = """
import asyncio, gc, json

import numpy as np
from numba.core.dispatcher import Dispatcher

from revisit.core.geometry import se3
from revisit.formats import quantised
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.features.ingest.clouds import unpack_cloud
from tests.support.block_worlds import along, seen, yard
from tests.support.driven_maps import driven, merged, real_world


def loaded():
    kernels = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    return {f"{kernel.py_func.__name__}{signature}" for kernel in kernels for signature in kernel.overloads}


async def life(recogniser):
    world, blocks = real_world(), yard(1, False)
    T_odom_world = se3.exp(np.array([3.0, -2.0, 0.5, 0.03, -0.02, 0.6]))
    for name, seed in (("first", 1), ("second", 2)):
        drive = seen(blocks, along((-20, 0), (15, 0)), seed)
        await driven(world, name, drive, T_odom_world, recogniser, leave_distance_m=0.0)
    return (await merged(world, "first", "second", recogniser))["verdict"]


recogniser = load_recogniser()
ready = loaded()
points = np.random.default_rng(0).uniform(-9.0, 9.0, (500, 3))
columns = {"intensity": np.ones(500), "ring": np.ones(500, int), "rgb": np.ones((500, 3), int)}
for sent in ({}, columns):
    unpack_cloud(quantised.encode(points, sent))
verdict = asyncio.run(life(recogniser))
print(json.dumps({"verdict": verdict, "ready": len(ready), "later": sorted(loaded() - ready)}))
"""


@pytest.mark.parametrize("beside", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_no_job_asks_for_a_kernel_that_its_worker_has_not_loaded(beside):
    folder = os.open(Path(kernels.__file__).parent, os.O_RDONLY)
    if beside:  # as if another worker warmed up just now
        fcntl.flock(folder, fcntl.LOCK_SH)
    command = [sys.executable, "-c", LIFE]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10 * PATIENCE_S, cwd=Path.cwd())
    os.close(folder)
    told = json.loads(ran.stdout.splitlines()[-1])
    assert told["ready"] > 50
    assert (told["verdict"], told["later"]) == ("MERGED", [])
