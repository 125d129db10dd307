"""The recognition benchmark: all experiments of a plan, and their report (`python -m lab.recognition`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lab.recognition.benchmark_plan import BenchmarkPlan, run_plan
from lab.recognition.comparison import Progress
from lab.recognition.experiment import Experiment
from lab.recognition.failures import Failure, bev_image
from lab.recognition.report import write_report
from revisit.core.config import PipelineConfig
from revisit.core.errors import RevisitError
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.datasets import Recording
from revisit.evaluation.loop_closure_method import LoopClosureMethod


def run_recognition_bench(
    plan: BenchmarkPlan, report: Progress, method: LoopClosureMethod | None = None
) -> tuple[list[Experiment], tuple[Path, Path]]:
    """Run the missing experiments and write the report into the plan's folder: the experiments, and its two files.

    `method` takes the product's place; its failures are then listed without the product's bird's-eye images.
    """
    # One thread a process: methods are compared by time, and several processes may run at once.
    torch.set_num_threads(1)
    experiments = list(run_plan(plan, report, method))
    if method is not None:
        return experiments, write_report(experiments, plan.folder, type(method).__name__)
    pictures = _BevPictures(_sources(plan))
    return experiments, write_report(experiments, plan.folder, load_packaged_models().version, pictures)


def _sources(plan: BenchmarkPlan) -> Iterator[tuple[Recording, PipelineConfig]]:
    """Every recording of the plan, with the product's parameters for it; simulated ones are there by now."""
    drives = [*plan.drives, *(one for pair in plan.sessions for one in pair)]
    for drive in drives if "sessions" in plan.protocols else plan.drives:
        yield drive.recorded(plan.recordings), plan.pipeline(drive.scene_scale)


class _BevPictures:
    """Bird's-eye images of failed pairs, made by the product from the recordings."""

    def __init__(self, sources: Iterable[tuple[Recording, PipelineConfig]]) -> None:
        self._sources = {recording.name: (recording, config) for recording, config in sources}

    def __call__(
        self, experiment: Experiment, failure: Failure
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Query and map submap, as they lie in the recording; None where one of them cannot be described."""
        try:
            query = self._image(experiment.query_recording, experiment.query_windows[failure.query])
            return query, self._image(experiment.map_recording, experiment.map_windows[failure.match])
        except RevisitError:
            return None

    def _image(self, recording: str, window: tuple[int, ...]) -> NDArray[np.float32]:
        source, config = self._sources[recording]
        return bev_image(source, window, config)
