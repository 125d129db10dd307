"""Kinds of fields on all scenes, and error over bytes on real ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from revisit.core.config import Field, ImplicitMapConfig
from revisit.core.profiles import Profile, profile_config
from revisit.evaluation.surfaces.bench import Row, measure
from revisit.evaluation.surfaces.scenes import Scene

PLANES = ImplicitMapConfig()
LEARNED = dataclasses.replace(PLANES, field=Field.LEARNED, weight_power=1.0)
KINDS = {
    "tangent planes (default)": PLANES,
    "tangent planes, weights d^-1": dataclasses.replace(PLANES, weight_power=1.0),
    "learned, 10 steps": LEARNED,
    "learned, no step": dataclasses.replace(LEARNED, steps=0),
    "as the paper: 10 steps a scan, decoder too": profile_config(Profile.PAPER).implicit_map,
}
SPACINGS_M = (0.3, 0.4, 0.5, 0.6, 0.8)
LEARNED_SPACINGS_M = (0.4, 0.6, 0.8)

Report = Callable[[str], None]


def compare_kinds(groups: dict[str, list[Scene]], report: Report) -> Iterator[Row]:
    """A row for each group of scenes and each of KINDS."""
    for name, scenes in groups.items():
        for kind, config in KINDS.items():
            report(f"{name}: {kind}")
            yield measure(name, kind, scenes, config)


def compare_spacings(name: str, scenes: list[Scene], report: Report) -> Iterator[Row]:
    """Rows of planes and of learned fields at several spacings of neural points: error over bytes."""
    for kind, config, spacings in (("planes", PLANES, SPACINGS_M), ("learned", LEARNED, LEARNED_SPACINGS_M)):
        for spacing in spacings:
            report(f"{name}: {kind}, {spacing} m")
            yield measure(name, f"{kind}, {spacing} m", scenes, with_spacing(config, spacing))


def with_spacing(config: ImplicitMapConfig, spacing: float) -> ImplicitMapConfig:
    """`config` for neural points so many metres apart: distances in voxels grow with them."""
    return dataclasses.replace(config, resolution=spacing, truncation=max(config.truncation, 1.5 * spacing))


def kinds_table(rows: Iterable[Row]) -> str:
    """The rows as a table in Markdown, lengths in centimetres."""
    head = (
        "| scenes | field | mean | accuracy, median | completeness, median | F at 5 / 10 / 20 cm | normals | kB "
        "| of raw | fit, CPU s |\n|---|---|---|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(_line(row) for row in rows)


def _line(row: Row) -> str:
    error = row.error
    scores = " / ".join(f"{score:.3f}" for score in error.f_score)
    lengths = " | ".join(f"{100 * x:.1f}" for x in (error.mean, error.accuracy_median, error.completeness_median))
    return (
        f"| {row.scenes} | {row.kind} | {lengths} | {scores} | {error.normal_deg:.1f} deg | {row.kilobytes:.1f} | "
        f"{100 * row.share:.2f} % | {row.fit_s:.2f} |\n"
    )


def draw_curve(rows: list[Row], file: Path) -> None:
    """The picture of mean error over bytes, one line for each kind."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for kind, marker in (("planes", "o"), ("learned", "s")):
        chosen = [row for row in rows if row.kind.startswith(kind)]
        share, error = [100 * row.share for row in chosen], [100 * row.error.mean for row in chosen]
        axes.plot(share, error, marker=marker, label={"planes": "tangent planes", "learned": "learned, 10 steps"}[kind])
        for row, x, y in zip(chosen, share, error, strict=True):
            axes.annotate(row.kind.split(", ")[1], (x, y), textcoords="offset points", xytext=(5, 5), fontsize=8)
    axes.set_xlabel("bytes of the stored map, % of the raw float32 cloud")
    axes.set_ylabel("mean distance to held-out scans and back, cm")
    axes.set_title("Real HDL-64 street, a third of the scans held out", fontsize=10)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=130)
    plt.close(figure)
