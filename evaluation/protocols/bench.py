"""`revisit bench recognition`: the whole programme, and its report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.errors import RevisitError
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.datasets import Recording
from revisit.evaluation.methods import Method
from revisit.evaluation.protocols.contest import Progress
from revisit.evaluation.protocols.programme import Programme, run_programme
from revisit.evaluation.protocols.trial import Trial
from revisit.evaluation.report.failures import Failure, bev_image
from revisit.evaluation.report.recognition import write_report


def run_recognition_bench(
    programme: Programme, report: Progress, method: Method | None = None
) -> tuple[list[Trial], tuple[Path, Path]]:
    """Run what is not on file yet and write the report into the programme's folder: the trials, and its two files.

    `method` takes the product's place; its failures are then listed without the product's bird's-eye images.
    """
    # One thread a process: methods are compared by time, and several processes may run at once.
    torch.set_num_threads(1)
    trials = list(run_programme(programme, report, method))
    if method is not None:
        return trials, write_report(trials, programme.folder, type(method).__name__)
    pictures = _BevPictures(_sources(programme))
    return trials, write_report(trials, programme.folder, load_packaged_models().version, pictures)


def _sources(programme: Programme) -> Iterator[tuple[Recording, PipelineConfig]]:
    """Every recording of the programme, with the product's parameters for it; simulated ones are there by now."""
    drives = [*programme.drives, *(one for pair in programme.sessions for one in pair)]
    for drive in drives if "sessions" in programme.protocols else programme.drives:
        yield drive.recorded(programme.recordings), programme.pipeline(drive.scene_scale)


class _BevPictures:
    """Bird's-eye images of failed pairs, made by the product from the recordings."""

    def __init__(self, sources: Iterable[tuple[Recording, PipelineConfig]]) -> None:
        self._sources = {recording.name: (recording, config) for recording, config in sources}

    def __call__(self, trial: Trial, failure: Failure) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Query and map submap, as they lie in the recording; None where one of them cannot be described."""
        try:
            query = self._image(trial.query_recording, trial.query_windows[failure.query])
            return query, self._image(trial.map_recording, trial.map_windows[failure.match])
        except RevisitError:
            return None

    def _image(self, recording: str, window: tuple[int, ...]) -> NDArray[np.float32]:
        source, config = self._sources[recording]
        return bev_image(source, window, config)
