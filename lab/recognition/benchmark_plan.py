"""The plan of the recognition benchmark: its experiments, and the files of their results, so that a run can go on."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Protocol

from lab.baselines import map_closures
from lab.baselines.bow3d import Bow3d
from lab.baselines.catalogue import ALL_BASELINES
from lab.recognition.comparison import (
    ComparedSubmap,
    Comparison,
    PerturbedRecording,
    Progress,
    QueriesAndMap,
    compare,
    describe_recording,
    verified_result,
)
from lab.recognition.experiment import Experiment
from lab.recognition.remembered_verdicts import RememberedVerdicts, remembered
from lab.recognition.scan_baseline import with_bow3d
from lab.recognition.sequential_baseline import with_map_closures
from lab.worlds.towns import DRIVES, SESSIONS, SimulatedDrive
from revisit.core.config import LoopConfig, PipelineConfig, SubmapConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.baselines import PlaceRecogniser
from revisit.evaluation.datasets import PosedClouds, Recording, open_recording
from revisit.evaluation.loop_closure_method import LoopClosureMethod, RevisitMethod
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.perturbations import Perturbation
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
        """The recording; `folder` may keep generated files."""


@dataclass(frozen=True)
class RecordedDrive:
    """A recording of one's own, in any layout of `evaluation.datasets.FORMATS`."""

    source: Path
    file_format: str = "kitti"

    @cached_property
    def scene_scale(self) -> float:
        """As estimated from its ranges. Raises as opening it does."""
        return estimate_scene_scale(open_recording(self.source, self.file_format))

    def recorded(self, folder: Path, progress: Progress | None = None) -> Recording:
        """The recording. Raises as opening it does."""
        return open_recording(self.source, self.file_format)


@dataclass(frozen=True)
class BenchmarkPlan:
    """The plan of a run. `drives` and `protocols` name a part of it; lengths in metres, jobs in processes.

    `folder` takes the results, `recordings` the simulated drives. Submaps start every 10 m and do not overlap, so that
    a drive is affordable; the gap of 25 of them is 250 m. With `verified_peers` the first candidates of each baseline
    are verified, too.
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
    verified_peers: bool = False

    def pipeline(self, scene_scale: float) -> PipelineConfig:
        """The product's parameters for a scene of that scale."""
        submap = dataclasses.replace(self.submap, min_range=self.submap.min_range * scene_scale)
        return PipelineConfig(submap=submap, scene_scale=scene_scale)

    def comparisons(
        self, ablation: str, method: LoopClosureMethod | None, scene_scale: float = 1.0
    ) -> list[tuple[str, Comparison]]:
        """The product (or `method`) and the baselines apart, each with the inputs of its results.

        With an ablation only the product's descriptor; without baselines the product alone.
        """
        config = self.pipeline(scene_scale)
        submap = config.submap
        who = repr(method) if method is not None else f"{load_packaged_models().version} {config}"
        candidates = self.candidates if ablation == "none" else 0
        product = Comparison(
            method or RevisitMethod(config, ablation), submap, self.loops, (), candidates, jobs=self.jobs
        )
        if ablation != "none" or not self.baselines:
            return [(who, product)]
        peers = Comparison(None, submap, self.loops, self.baselines, 0, scene_scale, jobs=self.jobs)
        about = repr((self.baselines, scene_scale, map_closures.is_installed(), Bow3d()))
        if not self.verified_peers or product.method is None:
            return [(who, product), (about, peers)]
        once = remembered(product.method)
        both = dataclasses.replace(peers, method=once, candidates=candidates, verified_peers=True)
        return [(f"{who} {about}", both)]


def run_plan(plan: BenchmarkPlan, report: Progress, method: LoopClosureMethod | None = None) -> Iterator[Experiment]:
    """All experiments, one by one; results on file for the same models and parameters are read."""
    for drive in plan.drives:
        yield from _DriveExperiments(plan, drive, report, method).all()
    if "sessions" in plan.protocols:
        for mapped, querying in plan.sessions:
            run = partial(_between_sessions, plan, mapped, querying, report)
            yield _experiment(plan, "sessions", (mapped, querying), method, run)


class _DriveExperiments:
    """The experiments on one drive. Descriptions that several experiments need are made once."""

    def __init__(self, plan: BenchmarkPlan, drive: Drive, report: Progress, method: LoopClosureMethod | None) -> None:
        self._plan, self._drive, self._report, self._method = plan, drive, report, method
        self._described: dict[tuple[str, str, Perturbation], list[ComparedSubmap]] = {}

    def all(self) -> Iterator[Experiment]:
        """The experiments that the plan names, in its order."""
        for protocol in self._plan.protocols:
            if protocol != "sessions":
                yield _experiment(self._plan, protocol, (self._drive,), self._method, partial(self._run, protocol))

    def _run(self, protocol: str, comparison: Comparison) -> Experiment:
        recording = self._drive.recorded(self._plan.recordings, self._report)
        asked_under = TURNED if protocol == "rotation" else HARDER.get(protocol, PLAIN)
        queries = self._submaps(PerturbedRecording(recording, asked_under), comparison)
        known = self._submaps(PerturbedRecording(recording), comparison) if protocol in HARDER else queries
        submaps = QueriesAndMap(recording.name, recording.name, queries, known)
        compared = compare(protocol, comparison, submaps, self._report)
        if protocol != "online" or not comparison.baselines:
            return compared
        behind = partial(verified_result, comparison, submaps, self._report) if comparison.verified_peers else None
        if isinstance(self._drive, SimulatedDrive):
            beams = self._drive.sensor.elevations_deg
            compared = with_bow3d(compared, recording, beams, behind, comparison.candidates)
        if not map_closures.is_installed():
            return compared
        return with_map_closures(compared, recording, comparison.submap, behind, comparison.candidates)

    def _submaps(self, source: PerturbedRecording, comparison: Comparison) -> list[ComparedSubmap]:
        method = comparison.method
        if isinstance(method, RememberedVerdicts):
            return self._joined(source, comparison, method)
        if isinstance(method, RevisitMethod) and method.ablation in ("bev-only", "normals-only"):
            whole = self._submaps(
                source, dataclasses.replace(comparison, method=dataclasses.replace(method, ablation="none"))
            )
            return [_part(one, method) for one in whole]
        key = repr(comparison.method), repr(comparison.baselines), source.perturbation
        if key not in self._described:
            self._described[key] = describe_recording(source, comparison, self._report)
        return self._described[key]

    def _joined(
        self, source: PerturbedRecording, comparison: Comparison, method: RememberedVerdicts
    ) -> list[ComparedSubmap]:
        """The descriptions of the product and of the baselines as one."""
        product = self._submaps(source, dataclasses.replace(comparison, method=method.method, baselines=()))
        peers = self._submaps(source, dataclasses.replace(comparison, method=None))
        pairs = zip(product, peers, strict=True)
        return [dataclasses.replace(peer, submap=own.submap) for own, peer in pairs]


def _part(described: ComparedSubmap, method: RevisitMethod) -> ComparedSubmap:
    """A submap as the ablation of `method` would have described it: its descriptor without the other part."""
    description = described.submap.description
    if description is None:
        return described
    leave_out = {"bev-only": "normals", "normals-only": "bev"}[method.ablation]
    vector = without_parts(description.vector, method.config.fusion, **{leave_out: True})
    submap = dataclasses.replace(described.submap, description=dataclasses.replace(description, vector=vector))
    return dataclasses.replace(described, submap=submap)


def _between_sessions(
    plan: BenchmarkPlan, mapped: Drive, querying: Drive, report: Progress, comparison: Comparison
) -> Experiment:
    """All submaps of one drive, `querying`, matched with those of another."""
    known, queries = (one.recorded(plan.recordings, report) for one in (mapped, querying))
    if isinstance(known, PosedClouds) and isinstance(queries, PosedClouds):
        queries = queries.beside(known)
    asked, described = (
        describe_recording(PerturbedRecording(recording), comparison, report) for recording in (queries, known)
    )
    return compare("sessions", comparison, QueriesAndMap(queries.name, known.name, asked, described), report)


def _experiment(
    plan: BenchmarkPlan,
    protocol: str,
    drives: tuple[Drive, ...],
    method: LoopClosureMethod | None,
    run: Callable[[Comparison], Experiment],
) -> Experiment:
    """The experiment with all methods at the scale of the first drive; results on file are read, not made again."""
    parts: list[Experiment] = []
    ablation = protocol if protocol in ABLATIONS else "none"
    for who, comparison in plan.comparisons(ablation, method, drives[0].scene_scale):
        fingerprint = _fingerprint(plan, drives, who)
        file = plan.folder / "experiments" / f"{protocol}-{fingerprint}.json"
        if not file.exists():
            run(comparison).write(file)
        parts.append(Experiment.read(file))
    return dataclasses.replace(parts[0], results=tuple(result for part in parts for result in part.results))


def _fingerprint(plan: BenchmarkPlan, drives: tuple[Drive, ...], who: str) -> str:
    """Twelve hexadecimal digits of all that decides the results besides the protocol."""
    settings = plan.submap, plan.loops, plan.candidates
    return hashlib.sha256(repr((who, drives, settings)).encode()).hexdigest()[:12]
