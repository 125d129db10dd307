"""Ablations of the product's descriptor where sensor, density or day differ (paper Table III).

`python -m lab.part_tables OUT [DRIVE ...]` prints, for each condition, the mean area under the curve of
the simulated test drives (`lab.worlds.towns`), whole and without a part each, with intervals of paired draws. OUT keeps
the drives and the descriptors; a second run goes on where the first ended. Similarities are standardised by the map.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from numpy.typing import NDArray

from lab.command_line import run
from lab.recognition.benchmark_plan import HARDER, PLAIN, TURNED, BenchmarkPlan
from lab.worlds.towns import DRIVES, SESSIONS, SimulatedDrive
from revisit.core.config import FusionConfig, PipelineConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.core.model_bundle import load_packaged_models
from revisit.evaluation.ablation import Ablation
from revisit.evaluation.cutting import cut
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submap
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import Description, RevisitMethod
from revisit.evaluation.matching import search_map
from revisit.evaluation.metrics import Interval, LoopProtocol, Outcomes, best_f1, mean_auc, precision_recall
from revisit.evaluation.perturbations import Perturbation

Vectors = NDArray[np.float32]

CONDITIONS: dict[str, tuple[Perturbation, Perturbation]] = {
    "as driven": (PLAIN, PLAIN),
    "every submap turned": (TURNED, TURNED),
    "16 beams ask": (HARDER["beams"], PLAIN),
    "a tenth of the points asks": (HARDER["density"], PLAIN),
}
"""How queries and map of one drive are perturbed."""
A_YEAR_LATER = "a year later"
FORMS = ("whole", "without the implicit map", "without normals", "without BEV")


@dataclass(frozen=True)
class DescribedDrive:
    """Descriptors (n, d) float32 of the submaps of a drive that could be described, and their positions (n, 3), m."""

    vectors: Vectors
    positions: NDArray[np.float64]


@dataclass(frozen=True)
class PartStudy:
    """Where drives and descriptors are kept, and how submaps are cut and loops counted: as in the benchmark."""

    folder: Path

    @property
    def plan(self) -> BenchmarkPlan:
        """The plan of the recognition benchmark: its submaps and its loops."""
        return BenchmarkPlan(self.folder, self.folder / "recordings")

    def described(self, drive: SimulatedDrive, perturbation: Perturbation, ablation: Ablation) -> DescribedDrive:
        """The submaps of a drive, from file where the same models and parameters have described them before."""
        config = self.plan.pipeline(drive.scene_scale)
        about = repr((load_packaged_models().version, config, drive, perturbation, ablation.value))
        file = self.folder / "described" / f"{drive.name}-{hashlib.sha256(about.encode()).hexdigest()[:16]}.npz"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            made = self._describe(drive, config, perturbation, ablation)
            np.savez(file, vectors=made.vectors, positions=made.positions)
        with np.load(file) as kept:
            return DescribedDrive(kept["vectors"], kept["positions"])

    def _describe(
        self, drive: SimulatedDrive, config: PipelineConfig, perturbation: Perturbation, ablation: Ablation
    ) -> DescribedDrive:
        recording = drive.recorded(self.plan.recordings)
        work = DescriptionWork(recording, config.submap, perturbation, RevisitMethod(config, ablation), 0)
        found = [describe_submap(work, task) for task in enumerate(cut(recording, config.submap))]
        kept = [(one.description.vector, one.position) for one in found if one.description is not None]
        return DescribedDrive(np.array([vector for vector, _ in kept]), np.array([position for _, position in kept]))


def formed(described: DescribedDrive, form: str, fusion: FusionConfig) -> DescribedDrive:
    """The same with descriptors of that form; the implicit map is left out in describing, not here."""
    if form not in ("without normals", "without BEV"):
        return described
    left_out = {"normals": form == "without normals", "bev": form == "without BEV"}
    vectors = [without_parts(vector, fusion, **left_out) for vector in described.vectors]
    return DescribedDrive(np.array(vectors), described.positions)


def judged(queries: DescribedDrive, mapped: DescribedDrive, loops: LoopProtocol, *, own_map: bool) -> Outcomes:
    """The first answer of every query by the standardised similarity.

    With `own_map` submap n of the map enters it after query n has asked; each query is known after it has asked. Raises
    ValueError where these are not the same submaps: one of them could not be described under every condition.
    """
    if own_map and len(queries.vectors) != len(mapped.vectors):
        raise ValueError(f"{len(queries.vectors)} queries are not the {len(mapped.vectors)} submaps of their own map")
    truth = (
        GroundTruth.within_session(queries.positions, loops)
        if own_map
        else GroundTruth.between_sessions(queries.positions, mapped.positions, loops.positive_radius_m)
    )
    known = _submaps(mapped)
    asking = known if queries is mapped else _submaps(queries)
    found = search_map(asking, known, 1, truth.allowed, own_map=own_map)
    score = [one[0].similarity if one else -np.inf for one in found]
    right = [bool(one and truth.positives[number, one[0].id]) for number, one in enumerate(found)]
    return Outcomes(np.array(score), np.array(right, dtype=bool), np.asarray(truth.positives.any(axis=1)))


def outcomes(study: PartStudy, drive: SimulatedDrive, condition: str, form: str) -> Outcomes:
    """One drive under one condition, by one form of the descriptor."""
    asked_under, mapped_under = CONDITIONS[condition]
    ablation = Ablation.NO_IMPLICIT if form == "without the implicit map" else Ablation.NONE
    fusion = study.plan.pipeline(drive.scene_scale).fusion
    mapped = formed(study.described(drive, mapped_under, ablation), form, fusion)
    queries = mapped
    if asked_under != mapped_under:
        queries = formed(study.described(drive, asked_under, ablation), form, fusion)
    return judged(queries, mapped, study.plan.loops, own_map=True)


def later_outcomes(study: PartStudy, form: str) -> list[Outcomes]:
    """The sessions of towns that have changed, by one form of the descriptor."""
    ablation = Ablation.NO_IMPLICIT if form == "without the implicit map" else Ablation.NONE
    found = []
    for before, after in SESSIONS:
        fusion = study.plan.pipeline(before.scene_scale).fusion
        mapped, queries = (formed(study.described(one, PLAIN, ablation), form, fusion) for one in (before, after))
        found.append(judged(queries, mapped, study.plan.loops, own_map=False))
    return found


def rows(study: PartStudy, drives: Sequence[SimulatedDrive]) -> Iterator[str]:
    """Lines of the Markdown table, as they become known."""
    for condition in (*CONDITIONS, A_YEAR_LATER):
        by_form = {
            form: later_outcomes(study, form) if condition == A_YEAR_LATER
            else [outcomes(study, drive, condition, form) for drive in drives]
            for form in FORMS
        }  # fmt: skip
        whole = by_form["whole"]
        cells = [_interval(mean_auc(whole)), *(_interval(mean_auc(by_form[form], whole), "+") for form in FORMS[1:])]
        others = (
            ", ".join(f"{np.mean([of(one) for one in by_form[form]]):.3f}" for form in FORMS) for of in (_f1, _recall)
        )
        yield f"| {condition} | {' | '.join((*cells, *others))} |"


def _submaps(described: DescribedDrive) -> list[DescribedSubmap]:
    """As the search of a recording takes them: all that it looks at is descriptors and positions."""
    return [
        DescribedSubmap(number, (number,), position, np.eye(4), 0.0, Description(vector, b"", 0, {}), None, 0)
        for number, (vector, position) in enumerate(zip(described.vectors, described.positions, strict=True))
    ]


def _f1(one: Outcomes) -> float:
    return best_f1(precision_recall(one))[0]


def _recall(one: Outcomes) -> float:
    return float((one.correct & one.has_loop).sum() / max(int(one.has_loop.sum()), 1))


def _interval(found: Interval, sign: str = "") -> str:
    return f"{found.value:{sign}.3f} [{found.low:{sign}.3f}, {found.high:{sign}.3f}]"


def main(out: Path, names: Annotated[list[str] | None, typer.Argument()] = None) -> None:
    """Print the table of the drives named, of all where none is."""
    torch.set_num_threads(1)
    print(f"| condition | {' | '.join(FORMS)} | largest F1 of the four | recall@1 |")
    print("|---|---|---|---|---|---|---|")
    for line in rows(PartStudy(out), [drive for drive in DRIVES if not names or drive.name in names]):
        print(line, flush=True)


if __name__ == "__main__":
    run(main)
