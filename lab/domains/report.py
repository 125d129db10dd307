"""The report on domains: every method in every domain, the mean, and the worst one; worlds from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # no display is needed

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from lab.domains.catalogue import Domain
from lab.recognition.comparison import PRODUCT, VERIFIED
from lab.recognition.document import Document
from lab.recognition.experiment import Experiment, MethodResult, scores
from lab.worlds.drives import DrivenWorld
from lab.worlds.open_world import OpenWorld
from revisit.evaluation.drive_acceptance import is_right
from revisit.evaluation.simulator.blocks import Material

_OURS = (PRODUCT, VERIFIED)
_FIGURES = (
    "AUC", "F1", "recall@1", "recall at full precision", "alone: accepted", "false", "as served: loops", "false"
)  # fmt: skip
_DRAWN_POINTS = 150_000
_COLOURS = {
    Material.GROUND: "#ded6c8", Material.GRASS: "#b5cf8f", Material.WALL: "#555555", Material.GLASS: "#7f9fff",
    Material.ROOF: "#a04030", Material.LEAF: "#2a9a2a", Material.METAL: "#c000c0", Material.CLOTH: "#000000",
    Material.WINDSCREEN: "#000000",
}  # fmt: skip


@dataclass(frozen=True)
class DomainFigures:
    """A method's figures in one domain.

    `accepted`, `false`: first answers that pass as pairs alone, None where it verifies nothing; `loops`, `false_loops`:
    as the service accepts them, None where no service would run the method.
    """

    auc: float
    f1: float
    recall_at_1: float
    recall_at_full_precision: float
    accepted: int | None
    false: int | None
    loops: int | None
    false_loops: int | None


def figures(experiment: Experiment, result: MethodResult) -> DomainFigures:
    """The figures of one method."""
    measured = scores(result, experiment.ground_truth())
    errors, loops = zip(result.poses.metres, result.poses.degrees, strict=True), result.loops
    verifies = bool(result.accepted) or result.method.endswith(("verified", "verification"))
    return DomainFigures(
        measured.recognition.auc.value, measured.recognition.max_f1.value, measured.recall_at_1,
        measured.recognition.recall_at_full_precision, len(result.accepted) if verifies else None,
        sum(not is_right(*error) for error in errors) if verifies else None,
        None if loops is None else len(loops.pairs), None if loops is None else loops.false,
    )  # fmt: skip


def write_domains(experiments: Sequence[Experiment], missing: Sequence[Domain], folder: Path) -> tuple[Path, Path]:
    """`domains.md` and `domains.html` in `folder`: tables of the experiments, and why other domains are missing."""
    document = Document("Recognition in domains built differently")
    methods = [result.method for result in experiments[0].results] if experiments else []
    of = {(e.sequence, r.method): figures(e, r) for e in experiments for r in e.results}
    names = [experiment.sequence for experiment in experiments]
    if experiments:
        document.heading("Area under the curve")
        document.table(["domain", "queries / with a loop", *methods], [_aucs(one, methods, of) for one in experiments])
        document.heading("The product in each domain")
        document.table(
            ["domain", *_FIGURES], [_row(name, of[name, m]) for name in names for m in methods if m in _OURS]
        )
        document.heading("Mean and worst domain")
        document.table(["method", "worst AUC (domain)", *_FIGURES], [_summary(m, names, of) for m in methods])
    for domain in missing:
        document.paragraph(f"Not run: {domain.name} ({domain.missing}).")
    return document.write(folder, "domains")


def draw_world(driven: DrivenWorld, file: Path) -> None:
    """The world from above, coloured by material, with the driven way."""
    figure, axes = plt.subplots(figsize=(8, 8), layout="constrained")
    points, materials = _sampled(driven.world, np.random.default_rng(0))
    colours = np.array([_COLOURS[kind] for kind in sorted(_COLOURS)])[materials]
    axes.scatter(points[:, 0], points[:, 1], s=0.2, c=list(colours), linewidths=0)
    way = driven.trajectory.T_world_sensor[:, :2, 3]
    axes.plot(way[:, 0], way[:, 1], color="red", linewidth=0.6)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=driven.name)
    figure.savefig(file, dpi=75)
    plt.close(figure)


def _sampled(world: OpenWorld, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (n, 3) spread over standing structure, by area, and thinly over the ground, with their materials (n,)."""
    edges = world.triangles[:, 1:] - world.triangles[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).astype(np.float64)
    area[world.materials == Material.GROUND] *= 0.02
    chosen = rng.choice(len(area), _DRAWN_POINTS, p=area / area.sum())
    along = rng.dirichlet(np.ones(3), _DRAWN_POINTS)
    return np.einsum("nk,nkd->nd", along, world.triangles[chosen]), world.materials[chosen]


def _aucs(experiment: Experiment, methods: Sequence[str], of: dict[tuple[str, str], DomainFigures]) -> list[str]:
    loops = int(experiment.ground_truth().positives.any(axis=1).sum())
    counts = f"{len(experiment.query_positions)} / {loops}"
    return [experiment.sequence, counts, *(f"{of[experiment.sequence, method].auc:.3f}" for method in methods)]


def _row(name: str, row: DomainFigures) -> list[str]:
    """A row of the product in one domain: of its descriptor alone, or verified."""
    return [f"{name}, {'verified' if row.accepted is not None else 'descriptor'}", *_cells([row])]


def _summary(method: str, names: Sequence[str], of: dict[tuple[str, str], DomainFigures]) -> list[str]:
    """A method's row: the worst domain by AUC, means, and the sums of accepted and false loops."""
    worst = min(names, key=lambda name: of[name, method].auc)
    return [method, f"{of[worst, method].auc:.3f} ({worst})", *_cells([of[name, method] for name in names])]


def _cells(rows: Sequence[DomainFigures]) -> list[str]:
    """The means of the figures, and the sums of the counts; nothing for counts that a method does not have."""
    shares = [(row.auc, row.f1, row.recall_at_1, row.recall_at_full_precision) for row in rows]
    alone = [(row.accepted, row.false) for row in rows]
    served = [(row.loops, row.false_loops) for row in rows]
    return [*(f"{mean:.3f}" for mean in np.mean(shares, axis=0)), *_sums(alone), *_sums(served)]


def _sums(counts: Sequence[tuple[int | None, int | None]]) -> list[str]:
    """The sums of pairs of counts, of the rows that have them."""
    known = [(count, false or 0) for count, false in counts if count is not None]
    return [str(sum(column)) for column in zip(*known, strict=True)] if known else ["", ""]
