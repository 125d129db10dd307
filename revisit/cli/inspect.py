"""`revisit inspect`: checks a recording before anything is sent."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from revisit.cli.extras import needs
from revisit.cli.options import HTTP, Http, Json
from revisit.cli.output import emit_json, emit_table, refuse, say, signs
from revisit.cli.recordings import Deskew, Format, Mounting, Odometry, Poses, Topic, opened

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.evaluation.inspection import Inspection
    from revisit.sdk.resources import Session

_SESSION = re.compile(r"maps/[^/]+/sessions/[^/]+")


def inspect(
    recording: Annotated[str, typer.Argument(help="A folder or a bag, or a stored maps/{map}/sessions/{session}.")],
    file_format: Format = "auto",
    topic: Topic = None,
    odometry: Odometry = None,
    mounting: Mounting = None,
    poses: Poses = None,
    deskew: Deskew = True,
    picture: Annotated[Path | None, typer.Option(help="Draw the path and one scan to this PNG or SVG file.")] = None,
    http: Http = HTTP,
    json: Json = False,
) -> None:
    """Check units, gravity, handedness, poses and times of a recording; exits with 2 where something is suspicious.

    For a stored session: the findings of the workers in its submaps.
    """
    if _SESSION.fullmatch(recording) and not Path(recording).exists():
        _inspect_session(recording, http, json)
    elif Path(recording).exists():
        _inspect_recording(Path(recording), (file_format, topic, odometry, mounting, poses, deskew), picture, json)
    else:
        raise refuse(f"{recording} is no folder, no bag, and no maps/{{map}}/sessions/{{session}}")


def _inspect_session(name: str, http: str, as_json: bool) -> None:
    from revisit.sdk.client import Client

    with Client(http) as client:
        session = client.get_session(name)
    figures = {
        "state": session.state,
        "scans": session.committed_seq,
        "submaps": session.submap_count,
        "travelled_m": round(session.travelled_m, 2),
    }
    findings = [asdict(finding) for finding in session.findings]
    if not as_json:
        findings = [{name: its for name, its in one.items() if name != "odometry_fault"} for one in findings]
    _report(session.name, figures, findings, as_json)


@needs("service")
def _inspect_recording(
    folder: Path,
    read_as: tuple[str, str | None, str | None, str | None, Path | None, bool],
    picture: Path | None,
    as_json: bool,
) -> None:
    """`read_as` are the options of `opened`."""
    from revisit.core.point_columns import COLUMNS
    from revisit.evaluation.inspection import inspect_recording

    recording = opened(folder, *read_as, columns=tuple(COLUMNS))
    inspection = inspect_recording(recording)
    if picture is not None:
        _draw(recording, inspection, picture)
    _report(recording.name, inspection.figures, [asdict(finding) for finding in inspection.findings], as_json)


@needs("evaluation")
def _draw(recording: Recording, inspection: Inspection, picture: Path) -> None:
    from revisit.evaluation.inspection_picture import draw_inspection

    draw_inspection(recording, inspection, picture)


def _report(name: str, figures: Mapping[str, Any], findings: list[dict[str, Any]], as_json: bool) -> None:
    """Print both; exits with 2 where there are findings."""
    if as_json:
        emit_json({"recording": name, "figures": figures, "findings": findings})
    else:
        emit_table(name, ("figure", "value"), figures.items())
        if findings:
            emit_table("Findings", tuple(findings[0]), [tuple(finding.values()) for finding in findings])
        else:
            say("Nothing suspicious.")
    if findings:
        raise typer.Exit(2)


def warn(recording: Recording) -> None:
    """Warn on stderr of likely mistakes in a recording."""
    from revisit.evaluation.inspection import inspect_recording

    signs.doing(f"looking at scans of {recording.name}")
    for finding in inspect_recording(recording).findings:
        line = f"{finding.measured}. Likely cause: {finding.cause}. {finding.advice[:1].upper()}{finding.advice[1:]}."
        typer.echo(f"{recording.name}: warning: {finding.code}: {line}", err=True)


def warn_of_findings(session: Session) -> None:
    """Warn on stderr of the workers' findings in a session."""
    for finding in session.findings:
        line = f"in {finding.submaps} submaps. Likely cause: {finding.cause}"
        typer.echo(f"{session.name}: warning: {finding.code}: {line}. To do: {finding.advice}.", err=True)
