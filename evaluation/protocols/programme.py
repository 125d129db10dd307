"""Which trials make up the recognition bench, and the files that keep their outcomes, so that a run can go on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

from core.config import LoopConfig, PipelineConfig, SubmapConfig
from core.model_bundle import load_packaged_models
from evaluation.baselines import ALL_BASELINES, PlaceRecogniser
from evaluation.datasets import PosedClouds, Recording, open_recording
from evaluation.methods import Method, PipelineMethod
from evaluation.metrics import LoopProtocol
from evaluation.perturbations import Perturbation
from evaluation.protocols.contest import Contest, Described, Progress, Side, Sides, describe_side, hold
from evaluation.protocols.towns import DRIVES, SESSIONS
from evaluation.protocols.trial import Trial

ABLATIONS = ("no-implicit", "bev-only", "normals-only")
PROTOCOLS = ("online", "rotation", "beams", "density", *ABLATIONS, "sessions")

PLAIN = Perturbation()
TURNED = Perturbation(rotate_seed=1)
# One side only: the queries. The map keeps all beams and points.
HARDER = {"beams": Perturbation(keep_beams=16), "density": Perturbation(keep_points=0.1)}


class Drive(Protocol):
    """Something that becomes a recording: a simulated drive, or a folder."""

    def recorded(self, folder: Path, progress: Progress | None = None) -> Recording:
        """The recording; `folder` may keep what has to be made."""


@dataclass(frozen=True)
class RecordedDrive:
    """A recording of one's own, in any layout of `evaluation.datasets.FORMATS`."""

    source: Path
    file_format: str = "kitti"

    def recorded(self, folder: Path, progress: Progress | None = None) -> Recording:
        """The recording. Raises what opening it raises."""
        return open_recording(self.source, self.file_format)


@dataclass(frozen=True)
class Programme:
    """What to run. `drives` and `protocols` name a part of it; lengths in metres, jobs in processes.

    `folder` takes the outcomes, `recordings` the simulated drives.
    """

    folder: Path
    recordings: Path
    drives: Sequence[Drive] = DRIVES
    sessions: Sequence[tuple[Drive, Drive]] = SESSIONS
    protocols: Sequence[str] = PROTOCOLS
    baselines: tuple[PlaceRecogniser, ...] = ALL_BASELINES
    submap: SubmapConfig = field(default_factory=SubmapConfig)
    loops: LoopProtocol = LoopProtocol(min_index_gap=LoopConfig().min_index_gap)
    candidates: int = LoopConfig().candidates
    jobs: int = 1

    def contest(self, ablation: str = "none", method: Method | None = None) -> Contest:
        """The methods of a trial; with an ablation only the product's descriptor."""
        method = method or PipelineMethod(PipelineConfig(submap=self.submap), ablation)
        if ablation != "none":
            return Contest(method, self.submap, self.loops, (), candidates=0, jobs=self.jobs)
        return Contest(method, self.submap, self.loops, self.baselines, self.candidates, jobs=self.jobs)


def run_programme(programme: Programme, report: Progress, method: Method | None = None) -> Iterator[Trial]:
    """All trials, one by one; those whose outcome is on file for the same models and parameters are read."""
    for drive in programme.drives:
        yield from _DriveTrials(programme, drive, report, method).all()
    if "sessions" in programme.protocols:
        for known, asking in programme.sessions:
            yield _on_file(programme, "sessions", (known, asking), method, partial(
                _between_sessions, programme, known, asking, report, method))  # fmt: skip


class _DriveTrials:
    """The trials on one drive. Descriptions that several trials need are made once."""

    def __init__(self, programme: Programme, drive: Drive, report: Progress, method: Method | None) -> None:
        self._programme, self._drive, self._report, self._method = programme, drive, report, method
        self._described: dict[tuple[str, Perturbation], list[Described]] = {}

    def all(self) -> Iterator[Trial]:
        """The trials that the programme names, in its order."""
        for protocol in self._programme.protocols:
            if protocol != "sessions":
                run = partial(self._run, protocol)
                yield _on_file(self._programme, protocol, (self._drive,), self._method, run)

    def _run(self, protocol: str) -> Trial:
        recording = self._drive.recorded(self._programme.recordings, self._report)
        ablation = protocol if protocol in ABLATIONS else "none"
        contest = self._programme.contest(ablation, self._method)
        asked_under = TURNED if protocol == "rotation" else HARDER.get(protocol, PLAIN)
        queries = self._side(Side(recording, asked_under), ablation, contest)
        known = self._side(Side(recording), ablation, contest) if protocol in HARDER else queries
        return hold(protocol, contest, Sides(recording.name, recording.name, queries, known), self._report)

    def _side(self, side: Side, ablation: str, contest: Contest) -> list[Described]:
        key = ablation, side.perturbation
        if key not in self._described:
            self._described[key] = describe_side(side, contest, self._report)
        return self._described[key]


def _between_sessions(
    programme: Programme, known: Drive, asking: Drive, report: Progress, method: Method | None
) -> Trial:
    """All submaps of one drive ask those of another."""
    places, queries = (one.recorded(programme.recordings, report) for one in (known, asking))
    if isinstance(places, PosedClouds) and isinstance(queries, PosedClouds):
        queries = queries.beside(places)
    contest = programme.contest("none", method)
    asked, described = (describe_side(Side(recording), contest, report) for recording in (queries, places))
    return hold("sessions", contest, Sides(queries.name, places.name, asked, described), report)


def _on_file(
    programme: Programme, protocol: str, drives: tuple[Drive, ...], method: Method | None, run: Callable[[], Trial]
) -> Trial:
    """The trial on file for the same drives, models and parameters, else a new one, which is then on file."""
    file = programme.folder / "trials" / f"{protocol}-{_fingerprint(programme, drives, method)}.json"
    if file.exists():
        return Trial.read(file)
    trial = run()
    trial.write(file)
    return trial


def _fingerprint(programme: Programme, drives: tuple[Drive, ...], method: Method | None) -> str:
    """Twelve hexadecimal digits of all that decides an outcome besides the protocol."""
    who = repr(method) if method is not None else f"{load_packaged_models().version} {PipelineConfig()}"
    settings = programme.submap, programme.loops, programme.candidates, programme.baselines
    return hashlib.sha256(repr((who, drives, settings)).encode()).hexdigest()[:12]
