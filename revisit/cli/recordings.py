"""Opening a recording for a command: the options that bags need, and notes on the choice of topics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.options import RECORDINGS
from revisit.cli.output import progress_bar, refuse, reporter, signs

if TYPE_CHECKING:
    from revisit.core.geometry.se3 import Matrix4
    from revisit.evaluation.datasets import Recording

Format = Annotated[str, typer.Option("--format", help=RECORDINGS)]
Topic = Annotated[
    str | None,
    typer.Option(
        "--topic",
        "--topics",
        help="Bags: topic of the clouds, instead of the fitting one. Several, as /front,/rear, are merged by sweep.",
    ),
]
Odometry = Annotated[
    str | None,
    typer.Option(
        "--odometry",
        help="Bags: topic of the poses, or /tf, instead of the fitting one. Bags and folders of clouds: 'kiss-icp' "
        "makes poses of the clouds (extra kiss-icp).",
    ),
]
Mounting = Annotated[
    str | None,
    typer.Option(
        "--T-body-sensor",
        help="Bags: where the sensor sits on what the poses follow: 'x y z qx qy qz qw', metres.",
    ),
]

Poses = Annotated[
    Path | None,
    typer.Option(
        "--poses",
        exists=True,
        dir_okay=False,
        help="Folders of clouds: file of their poses (TUM or KITTI), instead of the one beside them.",
    ),
]

Deskew = Annotated[
    bool,
    typer.Option(
        "--deskew/--no-deskew",
        help="Bags: move points that have times to the stamp of their cloud, by the odometry. --no-deskew for clouds "
        "that were deskewed before.",
    ),
]


def opened(
    folder: Path,
    file_format: str,
    topic: str | None,
    odometry: str | None,
    mounting: str | None,
    poses: Path | None = None,
    deskew: bool = True,
    limit: int | None = None,
    columns: tuple[str, ...] | None = None,
) -> Recording:
    """The recording; which topics of a bag were taken, and why, goes to stderr. Exits for an unusable option.

    Poses that are made of the clouds are made of the first `limit`. Scans have those of the `columns` that are there;
    None for the usual ones.
    """
    signs.doing(f"reading {folder}")
    from revisit.evaluation.datasets import (
        AUTO,
        FORMATS,
        KISS_ICP,
        WantedTopics,
        notes_of,
        open_recording,
        with_columns,
    )

    if file_format not in (AUTO, *FORMATS):
        raise refuse(f"--format is one of {', '.join((AUTO, *FORMATS))}")
    first, *together = [name.strip() for name in (topic or "").split(",")]
    wanted = WantedTopics(first or None, odometry, _transform(mounting), tuple(together), deskew)
    with progress_bar(quiet=odometry != KISS_ICP) as bar:
        recording = open_recording(folder, file_format, wanted, poses, reporter(bar), limit)
    for note in notes_of(recording):
        typer.echo(f"{recording.name}: {note}", err=True)
    return recording if columns is None else with_columns(recording, columns)


def _transform(text: str | None) -> Matrix4 | None:
    """The transform of seven numbers: a position and a quaternion (x, y, z, w)."""
    from revisit.core.geometry import se3

    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 7:
        raise refuse("--T-body-sensor takes seven numbers: 'x y z qx qy qz qw'")
    return se3.from_quaternion(numbers[3:], numbers[:3])
