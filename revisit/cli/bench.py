"""`revisit bench`: the declared metrics against the baseline, or a device beside the processor."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import needs
from revisit.cli.options import Json
from revisit.cli.output import emit_json, emit_table, refuse, say
from revisit.service import ONE_THREAD

if TYPE_CHECKING:
    from revisit.evaluation.benchmark import Metric

Update = Annotated[bool, typer.Option(help="Write the measured figures as the new baseline.")]
Check = Annotated[bool, typer.Option(help="End with status 1 where a figure is worse than the baseline by over 15 %.")]

OnDevice = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="Measure this device beside the processor instead: cuda, cuda:N, or torch-cpu, which only compares.",
    ),
]


@needs("evaluation")
def bench(check: Check = False, update: Update = False, json: Json = False, device: OnDevice = None) -> None:
    """Measure the declared figures and name those that are worse than in the committed baseline."""
    os.environ.update(ONE_THREAD)  # before a library reads it: times are those of one thread
    if device is not None:
        _measure_device(device, json)
    else:
        _measure(check, update, json)


def _measure(check: bool, update: bool, as_json: bool) -> None:
    """Measure and show; with `check` exit with status 1 where a metric became worse than the baseline allows."""
    from revisit.evaluation import benchmark

    measured, regressions = benchmark.run(update=update)
    _show(measured, as_json, {"regressions": regressions})
    if not as_json:
        for regression in regressions:
            say(f"worse: {regression}")
    if check and regressions:
        raise typer.Exit(1)


def _measure_device(name: str, as_json: bool) -> None:
    """Measure a device beside the processor; exit with status 1 where what they find differs, or it is not there."""
    from revisit.core.device import MissingDevice
    from revisit.evaluation.benchmark.device import beside_the_processor

    try:
        measured = beside_the_processor(name)
    except MissingDevice as missing:
        raise refuse(f"--device: {missing}") from missing
    _show(measured, as_json, {})
    if any(metric.value for metric in measured if metric.key.endswith("_that_differ")):
        raise typer.Exit(1)


def _show(measured: Sequence[Metric], as_json: bool, more: dict[str, Any]) -> None:
    if as_json:
        emit_json({"metrics": [_finite(asdict(metric)) for metric in measured], **more})
    else:
        emit_table("Bench", ("metric", "value", "unit"), [(m.key, m.value, m.unit) for m in measured])


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """Infinite tolerances (figures that are shown only) as nothing: JSON has no infinity."""
    return {key: None if value == float("inf") else value for key, value in fields.items()}
