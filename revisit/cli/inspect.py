"""`revisit inspect`: whether a recording can be what it claims, before anything is sent."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.options import Json
from revisit.cli.output import emit_json, emit_table, say
from revisit.cli.recordings import Format, Mounting, Odometry, Topic, opened

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording


@needs("evaluation")
def inspect(
    folder: Annotated[Path, typer.Argument(exists=True, help="The recording: a folder or a bag.")],
    file_format: Format = "auto",
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the path and one scan to this PNG or SVG file.")] = None,
    json: Json = False,
) -> None:
    """Check units, gravity, handedness, poses and times of a recording; exits with 2 where something is suspicious."""
    from revisit.evaluation.inspection import inspect_recording

    recording = opened(folder, file_format, topic, odometry, mounting)
    inspection = inspect_recording(recording)
    if picture is not None:
        from revisit.evaluation.report.inspection_picture import draw_inspection

        draw_inspection(recording, inspection, picture)
    findings = [asdict(finding) for finding in inspection.findings]
    if json:
        emit_json({"recording": recording.name, "figures": inspection.figures, "findings": findings})
    else:
        emit_table(recording.name, ("figure", "value"), inspection.figures.items())
        if findings:
            emit_table("Findings", tuple(findings[0]), [tuple(finding.values()) for finding in findings])
        else:
            say("Nothing suspicious.")
    if findings:
        raise typer.Exit(2)


def warn(recording: Recording) -> None:
    """Say on stderr what is suspicious about a recording."""
    from revisit.evaluation.inspection import inspect_recording

    for finding in inspect_recording(recording).findings:
        told = f"{finding.measured}. Likely cause: {finding.cause}. {finding.advice[:1].upper()}{finding.advice[1:]}."
        typer.echo(f"{recording.name}: warning: {finding.code}: {told}", err=True)
