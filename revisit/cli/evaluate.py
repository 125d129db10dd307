"""`revisit evaluate`: the paper's figures on a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import needs
from revisit.cli.inspect import warn
from revisit.cli.options import LeaveDistance, PositiveRadius, Stride, Tau
from revisit.cli.output import emit_table, progress_bar, refuse, reporter, say
from revisit.cli.recordings import Deskew, Format, Mounting, Odometry, Poses, Topic, opened

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.evaluation.perturbations import Perturbation
    from revisit.evaluation.recording_evaluation import EvaluationOptions

PROFILES = ("product", "paper")
ABLATIONS = ("none", "no-implicit", "bev-only", "normals-only")


@needs("service")
def evaluate(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording.")],
    file_format: Format = "auto",
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    poses: Poses = None,
    deskew: Deskew = True,
    json: Annotated[Path | None, typer.Option("--json", help="Write rows and summary to this file.")] = None,
    tau: Tau = None,
    stride: Stride = None,
    leave_distance: LeaveDistance = None,
    positive_radius: PositiveRadius = None,
    rotate_seed: Annotated[int | None, typer.Option(help="Turn every submap by a random yaw of this seed.")] = None,
    keep_beams: Annotated[int | None, typer.Option(help="Keep so many of 64 beams.")] = None,
    keep_points: Annotated[float, typer.Option(help="Keep this share of the points.")] = 1.0,
    ablation: Annotated[str, typer.Option(help="none, no-implicit, bev-only or normals-only.")] = "none",
    profile: Annotated[str, typer.Option(help="product, or paper: the method as it is written.")] = "product",
    scene_scale: Annotated[
        float | None, typer.Option(min=0.01, max=10.0, help="Size of the scene compared with a street; else estimated.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes.")] = None,
) -> None:
    """Score place recognition on a recording with poses, as the paper does."""
    from revisit.evaluation.recording_evaluation import EvaluationOptions

    lengths = {"tau": tau, "stride": stride, "leave_distance": leave_distance, "positive_radius": positive_radius}
    options = EvaluationOptions(
        perturbation=_perturbation(keep_beams, keep_points, rotate_seed),
        ablation=ablation, profile=profile, scene_scale=scene_scale, **given(**lengths, jobs=jobs),
    )  # fmt: skip
    if options.ablation not in ABLATIONS:
        raise refuse("--ablation is none, no-implicit, bev-only or normals-only")
    if options.profile not in PROFILES:
        raise refuse("--profile is product or paper")
    recording = opened(folder, file_format, topic, odometry, mounting, poses, deskew)
    warn(recording)
    _evaluate(recording, options, json)


def given(**options: Any) -> dict[str, Any]:
    """The options that were given; the others keep their defaults."""
    return {name: value for name, value in options.items() if value is not None}


def _perturbation(keep_beams: int | None, keep_points: float, rotate_seed: int | None) -> Perturbation:
    from revisit.evaluation.perturbations import Perturbation

    try:
        return Perturbation(keep_beams, keep_points, rotate_seed)
    except ValueError as error:
        raise refuse(str(error)) from error


def _evaluate(recording: Recording, options: EvaluationOptions, out: Path | None) -> None:
    """Evaluate a recording, write the rows, show the summary."""
    from revisit.evaluation import recording_evaluation

    with progress_bar(quiet=False) as bar:
        result = recording_evaluation.evaluate(recording, options, progress=reporter(bar))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        result.write_json(out)
    emit_table("Summary", ("figure", "value"), _flat({**result.summary, "rules": {}}))
    rules = result.summary.get("rules") or {}
    if rules:
        prices = [(doubt, price["right_lost"], price["false_stopped"]) for doubt, price in rules.items()]
        emit_table("What each rule turned down", ("doubt", "right loops lost", "false loops stopped"), prices)
    if out is not None:
        say(f"{len(result.queries)} rows in {out}")


def _flat(summary: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in summary.items():
        name = f"{prefix}{key}"
        rows += _flat(value, f"{name}.") if isinstance(value, dict) else [(name, value)]
    return rows
