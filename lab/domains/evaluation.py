"""Recognition in a domain: the product, its peers, and the peers with the product's verification behind them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from lab.baselines.augmented_scan_context import AugmentedScanContext
from lab.baselines.ring import Ring
from lab.baselines.ring_plus_plus import RingPlusPlus
from lab.domains.catalogue import Domain, Pass, Setting
from lab.domains.report import draw_world, write_domains
from lab.recognition.comparison import (
    ComparedSubmap,
    Comparison,
    PerturbedRecording,
    Progress,
    QueriesAndMap,
    compare,
    describe_recording,
)
from lab.recognition.experiment import Experiment
from lab.recognition.remembered_verdicts import remembered
from lab.worlds.drives import DrivenWorld
from revisit.core.config import PipelineConfig
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.baselines import PlaceRecogniser, ScanContext
from revisit.evaluation.loop_closure_method import LoopClosureMethod, RevisitMethod

PEERS: tuple[PlaceRecogniser, ...] = (Ring(), RingPlusPlus(), ScanContext(), AugmentedScanContext())
PROTOCOL = "domain"


def evaluate_domain(
    domain: Domain,
    folder: Path,
    report: Progress,
    *,
    share: float = 1.0,
    candidates: int = 20,
    method: LoopClosureMethod | None = None,
) -> Experiment:
    """The result in `domain`; one on file in `folder`, of the same models and parameters, is read.

    The product's descriptors lie beside it, with their positions: `NAME-vectors.npz`.
    """
    config = PipelineConfig(submap=domain.submap)
    used = method or RevisitMethod(config)
    settings = domain.name, domain.submap, domain.loops, share, candidates, PEERS
    stamp = f"{load_packaged_models().version} {used!r} {settings!r}"
    file = folder / f"{domain.name}-{hashlib.sha256(stamp.encode()).hexdigest()[:12]}.json"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        comparison = Comparison(
            remembered(used), domain.submap, domain.loops, PEERS, candidates, verified_peers=candidates > 0
        )
        recordings = domain.make(Setting(folder, share))
        if isinstance(recordings.queries, DrivenWorld):
            draw_world(recordings.queries, folder / f"{domain.name}.png")
        described = _described(recordings, comparison, report)
        _keep_vectors(described, folder / f"{domain.name}-vectors.npz")
        replace(compare(PROTOCOL, comparison, described, report), sequence=domain.name).write(file)
    return Experiment.read(file)


def run_domains(
    domains: Sequence[Domain], folder: Path, report: Progress, *, share: float = 1.0, candidates: int = 20
) -> tuple[Path, Path]:
    """Evaluate the `domains` that can be run here and write the report and the pictures of made-up worlds: its files.

    After each domain the report is written anew.
    """
    torch.set_num_threads(1)  # as the service does
    missing = [domain for domain in domains if domain.missing]
    experiments: list[Experiment] = []
    files = write_domains(experiments, missing, folder)
    for domain in domains:
        if domain in missing:
            continue
        experiments.append(evaluate_domain(domain, folder, report, share=share, candidates=candidates))
        files = write_domains(experiments, missing, folder)
    return files


def _described(recordings: Pass, comparison: Comparison, report: Progress) -> QueriesAndMap:
    """The submaps of one drive, or of the two of a pass."""
    asked = PerturbedRecording(recordings.queries, recordings.thinned_queries)
    queries = describe_recording(asked, comparison, report)
    mapped: Sequence[ComparedSubmap] = queries
    if recordings.mapped is not None:
        mapped = describe_recording(PerturbedRecording(recordings.mapped, recordings.thinned_map), comparison, report)
    known = recordings.mapped or recordings.queries
    return QueriesAndMap(recordings.queries.name, known.name, queries, mapped)


def _keep_vectors(submaps: QueriesAndMap, file: Path) -> None:
    """The product's descriptors (n, d) and positions (n, 3) of all submaps that have one; the map's first."""
    both = submaps.queries if submaps.own_map else [*submaps.mapped, *submaps.queries]
    usable = [one.submap for one in both if one.submap.description is not None]
    vectors = [one.description.vector for one in usable if one.description is not None]
    np.savez(file, vectors=np.array(vectors), positions=np.array([one.position for one in usable]))
