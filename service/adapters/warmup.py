"""Everything that is compiled in a worker, done once before it takes jobs (docs/decisions/0289).

Compiling in the middle of its life would cost a job some seconds, and the worker memory for good. The compiler caches
its code: where several workers start with an empty cache, they begin at different ends, and each loads the other's
code. A worker that starts alone has another process do so (docs/decisions/0289).
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit import formats
from revisit.core import kernels
from revisit.core.config import PipelineConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.kernels import adapted_cosines
from revisit.core.kernels.range_coder import finish, start
from revisit.core.model_bundle import load_packaged_models
from revisit.core.place import Place
from revisit.core.pose_graph import normal_equations
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.formats import quantised_columns
from revisit.formats.glb import encode_scene
from revisit.service import python_subprocess
from revisit.service.ports.recogniser import PlaceRecogniser

Array64 = NDArray[np.float64]

CONFIG = PipelineConfig()
GROUND_M = -1.7

COMPILED_FIRST = 2
"""After so many steps a process knows whether anything is compiled, and whether it is alone: they take two seconds."""

COMPANION = """
import signal
signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback where someone presses Ctrl-C
from revisit.service.adapters.core_recogniser import accompany_worker
accompany_worker()
"""

_PR_SET_PDEATHSIG = 1

Step = Callable[[], object]


def warm_up(recogniser: PlaceRecogniser) -> None:
    """Do each kind of a worker's work once (scans, submaps, pairs, maps, meshes, poses): the last first, where another
    process does so already. One that is alone, with a core to spare, and has to compile gets a companion that does.

    Whether the made-up scene can be described does not matter. A fault that matters will show on a real submap.
    """
    steps = _steps(recogniser)
    with _ends() as (beginning, end):
        if not _take(beginning):
            _take(end)
            _do(reversed(steps))
            return
        _do(steps[:COMPILED_FIRST])
        helped = _has_compiled(finish) and len(os.sched_getaffinity(0)) > 1 and _take(end)
        with _companion() if helped else nullcontext():
            _do(steps[COMPILED_FIRST:])


def accompany(recogniser: PlaceRecogniser) -> None:
    """As `warm_up`, the last first, in a companion: it ends with the process that has started it."""
    end_with_parent()
    _do(reversed(_steps(recogniser)))


def end_with_parent() -> None:
    """Let the kernel end this process as soon as its parent is gone. Another system than Linux goes on."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _steps(recogniser: PlaceRecogniser) -> tuple[Step, ...]:
    """They know nothing of each other. The gateway asks for the first and the third, too."""
    return (
        quantised_columns.warm_up,
        _end_a_stream,
        adapted_cosines.warm_up,
        partial(_describe_again, recogniser),
        partial(_describe, recogniser),
        partial(_verify, recogniser),
        _draw,
        normal_equations.warm_up,
    )


def _do(steps: Iterable[Step]) -> None:
    for step in steps:
        with suppress(RevisitError):
            step()


@contextmanager
def _ends() -> Iterator[list[int]]:
    """Two folders, open: processes tell each other by their locks at which end somebody has begun."""
    folders = [os.open(Path(str(module.__file__)).parent, os.O_RDONLY) for module in (kernels, formats)]
    try:
        yield folders
    finally:
        for folder in folders:
            os.close(folder)


def _take(folder: int) -> bool:
    """Whether no other process has taken this open folder for itself, as this one does now until it closes it."""
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # or the file system knows no locks
        return False
    return True


@contextmanager
def _companion() -> Iterator[None]:
    """Another process, which compiles from the other end meanwhile."""
    try:
        process = subprocess.Popen(
            python_subprocess.command("-c", COMPANION), env=python_subprocess.environment(), stdin=subprocess.DEVNULL
        )
    except OSError:  # no process is free just now: then it takes longer
        yield
        return
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _end_a_stream() -> None:
    """Run a small kernel that the gateway never asks for: it tells whether any worker has compiled here before."""
    data = np.zeros(4, np.uint8)
    finish(start(data, reads=False), data)


def _has_compiled(kernel: Any) -> bool:
    """Whether this process has compiled a kernel, and not loaded another one's code."""
    return bool(kernel.stats.cache_misses)


def _describe_again(recogniser: PlaceRecogniser) -> None:
    """Describe the surface of a neural map: the larger part of describing scans. And ask for its field, as merging
    does.
    """
    points, normals, _ = _yard(0)
    positions, hits = points.astype(np.float32), np.full(len(points), 2, np.int32)
    known = NeuralPoints.remembered(positions, normals.astype(np.float32), hits, 3)
    stored = NeuralMap.of_planes(known, np.arange(3), CONFIG.implicit_map).to_blob()
    recogniser.describe_again(stored, None, CONFIG)
    NeuralMap.from_blob(stored, load_packaged_models().decoder, CONFIG.implicit_map).neighbourhood(positions)


def _describe(recogniser: PlaceRecogniser) -> None:
    """Look at the scans of a yard, by a sensor that leans, and describe them."""
    yard, scans = _yard(0)[0], []
    for stamp_s, x in enumerate((0.0, 2.5, 5.0)):
        T_odom_sensor = se3.exp(np.array([x, 0.0, 0.0, 0.02, 0.01, 0.0]))
        scans.append(Scan.validated(se3.apply(se3.inverse(T_odom_sensor), yard), T_odom_sensor, stamp_s * 10**9))
    recogniser.inspect(scans)
    recogniser.describe(Submap.from_scans(scans, CONFIG.submap), CONFIG)


def _verify(recogniser: PlaceRecogniser) -> None:
    """Compare a place with itself, and with another one: there few keypoints agree, so that images are compared."""
    one, other = (_place(seed).to_blob() for seed in (0, 1))
    recogniser.verify(one, one, 1.0, CONFIG)
    recogniser.verify(one, other, 1.0, CONFIG)


def _draw() -> None:
    """Compress a mesh; the gateway, which does so on request, loads the code compiled here."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.sin(x + y).ravel()]).astype(np.float32)
    corners = np.arange(399).reshape(-1, 1) + np.array([0, 1, 20])
    encode_scene(vertices, corners[(corners[:, 1] % 20 > 0) & (corners[:, 2] < 400)].astype(np.int32))


def _place(seed: int) -> Place:
    """A place that saw a yard, with keypoints that look like nothing elsewhere."""
    rng, (points, normals, standing) = np.random.default_rng(seed), _yard(seed)
    thinned, parity = slice(None, None, 3), load_packaged_models().codebooks.local_parity
    descriptors = rng.normal(size=(60, len(parity)))
    return Place(
        rng.uniform(-20, 20, (60, 2)).astype(np.float32), rng.uniform(0, np.pi, 60).astype(np.float32),
        (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32), parity,
        points[thinned].astype(np.float32), normals[thinned].astype(np.float32), len(range(0, standing, 3)), "made up",
    )  # fmt: skip


def _yard(seed: int) -> tuple[Array64, Array64, int]:
    """Points (n, 3) and normals (n, 3) of four walls on a floor of 40 x 40 m, 4 a square metre; how many the walls
    have, which come first.
    """
    rng, walls, normals = np.random.default_rng(seed), [], []
    for along_x in (True, True, False, False):
        along, up, (x, y) = rng.uniform(-6, 6, 600), rng.uniform(GROUND_M, 4, 600), rng.uniform(-14, 14, 2)
        walls.append(np.column_stack([x + along_x * along, y + (not along_x) * along, up]))
        normals.append(np.tile([not along_x, along_x, 0.0], (600, 1)))
    floor = np.column_stack([rng.uniform(-20, 20, (6400, 2)), np.full(6400, GROUND_M)])
    return np.vstack([*walls, floor]), np.vstack([*normals, np.tile([0.0, 0.0, 1.0], (6400, 1))]), 2400
