"""evaluate: the paper's figures on a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.progress import Progress, TaskID

from revisit.cli.output import emit_table, progress_bar, refuse, say
from revisit.evaluation.datasets import FORMATS, open_recording
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.runner import EvaluationOptions, evaluate


def options(
    tau: float | None,
    stride: float | None,
    min_index_gap: int | None,
    positive_radius: float | None,
    rotate_seed: int | None,
    keep_beams: int | None,
    keep_points: float,
    ablation: str,
    scene_scale: float | None,
    jobs: int | None,
) -> EvaluationOptions:
    """The options that were given; the others keep their defaults."""
    chosen = given(tau=tau, stride=stride, min_index_gap=min_index_gap, positive_radius=positive_radius, jobs=jobs)
    try:
        perturbation = Perturbation(keep_beams, keep_points, rotate_seed)
    except ValueError as error:
        raise refuse(str(error)) from error
    return EvaluationOptions(perturbation=perturbation, ablation=ablation, scene_scale=scene_scale, **chosen)


def given(**options: Any) -> dict[str, Any]:
    """The options that were given."""
    return {name: value for name, value in options.items() if value is not None}


def evaluate_folder(folder: Path, file_format: str, chosen: EvaluationOptions, out: Path | None) -> None:
    """Evaluate a recording, write the rows, show the summary."""
    if file_format not in FORMATS:
        raise refuse(f"--format is one of {', '.join(FORMATS)}")
    if chosen.ablation not in ("none", "no-implicit", "bev-only", "normals-only"):
        raise refuse("--ablation is none, no-implicit, bev-only or normals-only")
    with progress_bar(quiet=False) as bar:
        result = evaluate(open_recording(folder, file_format), chosen, progress=_reporter(bar))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        result.write_json(out)
    emit_table("Summary", ("figure", "value"), _flat(result.summary))
    if out is not None:
        say(f"{len(result.queries)} rows in {out}")


def _reporter(bar: Progress) -> Callable[[str, int, int], None]:
    tasks: dict[str, TaskID] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=total)
        bar.update(tasks[stage], completed=done)

    return report


def _flat(summary: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in summary.items():
        name = f"{prefix}{key}"
        rows += _flat(value, f"{name}.") if isinstance(value, dict) else [(name, value)]
    return rows
