"""Describing all submaps of a recording, in as many processes as wanted."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.evaluation.cutting import Window, load_submap
from revisit.evaluation.datasets import Recording
from revisit.evaluation.loop_closure_method import Description, LoopClosureMethod
from revisit.evaluation.perturbations import Perturbation, turned

Task = TypeVar("Task")
Context = TypeVar("Context")
Result = TypeVar("Result")

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class DescribedSubmap:
    """A submap as stored.

    `position` (3,) is the mean position of its scans in the world; `T_world_submap` the pose of its middle scan; `yaw`
    the turn it was described under; `failure` why it could not be described, else None; `bad_scans` those of the window
    that could not be used. Positions and poses are those of the scans used, or of all where none could be.
    """

    id: int
    window: Window
    position: NDArray[np.float64]
    T_world_submap: se3.Matrix4
    yaw: float
    description: Description | None
    failure: str | None
    points: int
    bad_scans: tuple[int, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DescriptionWork:
    """Everything a process needs to describe any submap of a recording. Without a method nothing is described."""

    recording: Recording
    config: SubmapConfig
    perturbation: Perturbation
    method: LoopClosureMethod | None
    seed: int


def describe_submaps(work: DescriptionWork, windows: Sequence[Window], jobs: int) -> Iterator[DescribedSubmap]:
    """One place a window, in order, as they become ready."""
    return in_processes(describe_submap, work, list(enumerate(windows)), jobs)


def describe_submap(work: DescriptionWork, task: tuple[int, Window]) -> DescribedSubmap:
    """Build, turn and describe one submap. A submap the method refuses becomes a place with its failure."""
    index, window = task
    yaw, started, points = work.perturbation.yaw(index), time.process_time(), 0
    description, failure = None, None
    used: Window = ()
    try:
        submap, used = load_submap(work.recording, window, work.config, work.perturbation)
        submap = turned(submap, yaw)
        points, loaded = len(submap.points), time.process_time()
        description = work.method.describe(submap, work.seed) if work.method else None
    except RevisitError as error:
        failure, loaded = f"{error.code}: {error.message}", time.process_time()
    poses = [work.recording.pose(scan) for scan in used or window]
    return DescribedSubmap(
        id=index, window=window, position=np.mean([pose[:3, 3] for pose in poses], axis=0),
        T_world_submap=poses[len(poses) // 2], yaw=yaw, description=description, failure=failure, points=points,
        bad_scans=tuple(scan for scan in window if scan not in used),
        seconds={"load": loaded - started, "describe": time.process_time() - loaded},
    )  # fmt: skip


def in_processes(
    function: Callable[[Context, Task], Result], context: Context, tasks: Sequence[Task], jobs: int
) -> Iterator[Result]:
    """`function(context, task)` of every task, in order; `jobs` spawned processes of one thread each, or this one."""
    if jobs <= 1 or len(tasks) <= 1:
        yield from (function(context, task) for task in tasks)
        return
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        min(jobs, len(tasks)), mp_context=spawn, initializer=_Installed.install, initargs=(function, context)
    ) as pool:
        yield from pool.map(_Installed.run, tasks, chunksize=max(1, min(8, len(tasks) // (4 * jobs))))


class _Installed:
    """The work of this process: it is sent once, when the process starts, and not with every task."""

    function: Callable[[Any, Any], Any]
    context: Any

    @classmethod
    def install(cls, function: Callable[[Any, Any], Any], context: Any) -> None:
        """Keep the work."""
        cls.function, cls.context = staticmethod(function), context

    @classmethod
    def run(cls, task: Any) -> Any:
        """The work done on one task."""
        return cls.function(cls.context, task)
