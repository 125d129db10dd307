"""`revisit bench`: the declared metrics against the baseline."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import needs
from revisit.cli.options import Json
from revisit.cli.output import emit_json, emit_table, say
from revisit.service import ONE_THREAD

if TYPE_CHECKING:
    from revisit.evaluation.benchmark import Metric

Update = Annotated[bool, typer.Option(help="Write the measured figures as the new baseline.")]
Check = Annotated[bool, typer.Option(help="End with status 1 where a figure is worse than the baseline by over 15 %.")]


@needs("evaluation")
def bench(check: Check = False, update: Update = False, json: Json = False) -> None:
    """Measure the declared figures and name those that are worse than in the committed baseline."""
    os.environ.update(ONE_THREAD)  # before a library reads it: times are those of one thread
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


def _show(measured: Sequence[Metric], as_json: bool, more: dict[str, Any]) -> None:
    if as_json:
        emit_json({"metrics": [_finite(asdict(metric)) for metric in measured], **more})
    else:
        emit_table("Bench", ("metric", "value", "unit"), [(m.key, m.value, m.unit) for m in measured])


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    """Infinite tolerances (figures that are shown only) as nothing: JSON has no infinity."""
    return {key: None if value == float("inf") else value for key, value in fields.items()}
