"""Which trials make up the recognition bench, and the files that keep their outcomes, so that a run can go on."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Protocol

from revisit.core.config import LoopConfig, PipelineConfig, SubmapConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.baselines import ALL_BASELINES, PlaceRecogniser
from revisit.evaluation.datasets import PosedClouds, Recording, open_recording
from revisit.evaluation.methods import Method, PipelineMethod
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.protocols.contest import Contest, Described, Progress, Side, Sides, describe_side, hold
from revisit.evaluation.protocols.towns import DRIVES, SESSIONS
from revisit.evaluation.protocols.trial import Trial
from revisit.evaluation.scene import estimate_scene_scale

ABLATIONS = ("no-implicit", "bev-only", "normals-only")
PROTOCOLS = ("online", "rotation", "beams", "density", *ABLATIONS, "sessions")

PLAIN = Perturbation()
TURNED = Perturbation(rotate_seed=1)
# One side only: the queries. The map keeps all beams and points.
HARDER = {"beams": Perturbation(keep_beams=16), "density": Perturbation(keep_points=0.1)}


class Drive(Protocol):
    """Something that becomes a recording: a simulated drive, or a folder."""

    @property
    def scene_scale(self) -> float:
        """Size of the scene compared with a street (`PipelineConfig.scene_scale`)."""

    def recorded(self, folder: Path, progress: Progress | None = None) -> Recording:
        """The recording; `folder` may keep what has to be made."""


@dataclass(frozen=True)
class RecordedDrive:
    """A recording of one's own, in any layout of `evaluation.datasets.FORMATS`."""

    source: Path
    file_format: str = "kitti"

    @cached_property
    def scene_scale(self) -> float:
        """As estimated from its ranges. Raises what opening it raises."""
        return estimate_scene_scale(open_recording(self.source, self.file_format))

    def recorded(self, folder: Path, progress: Progress | None = None) -> Recording:
        """The recording. Raises what opening it raises."""
        return open_recording(self.source, self.file_format)


@dataclass(frozen=True)
class Programme:
    """What to run. `drives` and `protocols` name a part of it; lengths in metres, jobs in processes.

    `folder` takes the outcomes, `recordings` the simulated drives. Submaps start every 10 m and do not overlap, so that
    a drive is affordable; the gap of 25 of them is 250 m.
    """

    folder: Path
    recordings: Path
    drives: Sequence[Drive] = DRIVES
    sessions: Sequence[tuple[Drive, Drive]] = SESSIONS
    protocols: Sequence[str] = PROTOCOLS
    baselines: tuple[PlaceRecogniser, ...] = ALL_BASELINES
    submap: SubmapConfig = SubmapConfig(stride=10.0)
    loops: LoopProtocol = LoopProtocol(min_index_gap=25)
    candidates: int = LoopConfig().candidates
    jobs: int = 1

    def pipeline(self, scene_scale: float) -> PipelineConfig:
        """The product's parameters for a scene of that scale."""
        submap = dataclasses.replace(self.submap, min_range=self.submap.min_range * scene_scale)
        return PipelineConfig(submap=submap, scene_scale=scene_scale)

    def contests(self, ablation: str, method: Method | None, scene_scale: float = 1.0) -> list[tuple[str, Contest]]:
        """The product (or `method`) and the baselines apart, each with what decides its outcome besides the question.

        With an ablation only the product's descriptor.
        """
        config = self.pipeline(scene_scale)
        submap = config.submap
        who = repr(method) if method is not None else f"{load_packaged_models().version} {config}"
        candidates = self.candidates if ablation == "none" else 0
        product = Contest(
            method or PipelineMethod(config, ablation), submap, self.loops, (), candidates, jobs=self.jobs
        )
        if ablation != "none":
            return [(who, product)]
        peers = Contest(None, submap, self.loops, self.baselines, 0, scene_scale, jobs=self.jobs)
        return [(who, product), (repr((self.baselines, scene_scale)), peers)]


def run_programme(programme: Programme, report: Progress, method: Method | None = None) -> Iterator[Trial]:
    """All trials, one by one; those whose outcome is on file for the same models and parameters are read."""
    for drive in programme.drives:
        yield from _DriveTrials(programme, drive, report, method).all()
    if "sessions" in programme.protocols:
        for known, asking in programme.sessions:
            run = partial(_between_sessions, programme, known, asking, report)
            yield _trial(programme, "sessions", (known, asking), method, run)


class _DriveTrials:
    """The trials on one drive. Descriptions that several trials need are made once."""

    def __init__(self, programme: Programme, drive: Drive, report: Progress, method: Method | None) -> None:
        self._programme, self._drive, self._report, self._method = programme, drive, report, method
        self._described: dict[tuple[str, str, Perturbation], list[Described]] = {}

    def all(self) -> Iterator[Trial]:
        """The trials that the programme names, in its order."""
        for protocol in self._programme.protocols:
            if protocol != "sessions":
                yield _trial(self._programme, protocol, (self._drive,), self._method, partial(self._run, protocol))

    def _run(self, protocol: str, contest: Contest) -> Trial:
        recording = self._drive.recorded(self._programme.recordings, self._report)
        asked_under = TURNED if protocol == "rotation" else HARDER.get(protocol, PLAIN)
        queries = self._side(Side(recording, asked_under), contest)
        known = self._side(Side(recording), contest) if protocol in HARDER else queries
        return hold(protocol, contest, Sides(recording.name, recording.name, queries, known), self._report)

    def _side(self, side: Side, contest: Contest) -> list[Described]:
        method = contest.method
        if isinstance(method, PipelineMethod) and method.ablation in ("bev-only", "normals-only"):
            whole = self._side(side, dataclasses.replace(contest, method=dataclasses.replace(method, ablation="none")))
            return [_part(one, method) for one in whole]
        key = repr(contest.method), repr(contest.baselines), side.perturbation
        if key not in self._described:
            self._described[key] = describe_side(side, contest, self._report)
        return self._described[key]


def _part(described: Described, method: PipelineMethod) -> Described:
    """A submap as the ablation of `method` would have described it: its descriptor without the other part."""
    description = described.place.description
    if description is None:
        return described
    leave_out = {"bev-only": "normals", "normals-only": "bev"}[method.ablation]
    vector = without_parts(description.vector, method.config.fusion, **{leave_out: True})
    place = dataclasses.replace(described.place, description=dataclasses.replace(description, vector=vector))
    return dataclasses.replace(described, place=place)


def _between_sessions(programme: Programme, known: Drive, asking: Drive, report: Progress, contest: Contest) -> Trial:
    """All submaps of one drive ask those of another."""
    places, queries = (one.recorded(programme.recordings, report) for one in (known, asking))
    if isinstance(places, PosedClouds) and isinstance(queries, PosedClouds):
        queries = queries.beside(places)
    asked, described = (describe_side(Side(recording), contest, report) for recording in (queries, places))
    return hold("sessions", contest, Sides(queries.name, places.name, asked, described), report)


def _trial(
    programme: Programme,
    protocol: str,
    drives: tuple[Drive, ...],
    method: Method | None,
    run: Callable[[Contest], Trial],
) -> Trial:
    """The trial of all contests at the scale of the first drive; what is on file for the same is not run again."""
    parts: list[Trial] = []
    ablation = protocol if protocol in ABLATIONS else "none"
    for who, contest in programme.contests(ablation, method, drives[0].scene_scale):
        fingerprint = _fingerprint(programme, drives, who)
        file = programme.folder / "trials" / f"{protocol}-{fingerprint}.json"
        if not file.exists():
            run(contest).write(file)
        parts.append(Trial.read(file))
    return dataclasses.replace(parts[0], outcomes=tuple(outcome for part in parts for outcome in part.outcomes))


def _fingerprint(programme: Programme, drives: tuple[Drive, ...], who: str) -> str:
    """Twelve hexadecimal digits of all that decides an outcome besides the protocol."""
    settings = programme.submap, programme.loops, programme.candidates
    return hashlib.sha256(repr((who, drives, settings)).encode()).hexdigest()[:12]
