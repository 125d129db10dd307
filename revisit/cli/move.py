"""`revisit move`: an installation to other engines."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, progress_bar, refuse

if TYPE_CHECKING:
    from rich.progress import TaskID

    from revisit.service.engines.move import Moved
    from revisit.service.settings import Settings


@needs("service")
def move(
    to_home: Annotated[Path | None, typer.Option(help="SQLite and files in this folder.")] = None,
    to_database: Annotated[str, typer.Option(help="PostgreSQL, as postgresql://user@host/name.")] = "",
    to_blobs: Annotated[str, typer.Option(help="A bucket, as s3://bucket/prefix; else files, in --to-home.")] = "",
    home: Home = None,
    json: Json = False,
) -> None:
    """Copy an installation that no process serves to other engines, and compare; again where it was broken off."""
    from revisit.service.settings_loading import load_settings

    os.umask(0o077)
    source = load_settings(home)
    target = source.model_copy(
        update={"home": to_home or source.home, "database_url": to_database, "blob_url": to_blobs}
    )
    if (target.home, target.database_url) == (source.home, source.database_url):
        raise refuse("name the new place of the state: --to-database, or --to-home for SQLite")
    if not to_blobs and to_home is None and source.blob_url:
        raise refuse("name the new place of the blobs: --to-blobs, or --to-home for files")
    moved = _moved(source, target)
    if json:
        emit_json(asdict(moved))
        return
    rows = sum(moved.rows.values())
    typer.echo(f"{rows} rows and {moved.blobs} blobs are there, and equal (SHA-256 of the rows {moved.sha256})")


def _moved(source: Settings, target: Settings) -> Moved:
    """What is in the new place. Raises typer.Exit."""
    from revisit.service.engines.local.files.home_lock import HomeTaken
    from revisit.service.engines.move import MoveRefused
    from revisit.service.engines.schema import ForeignSchema, UnusableServer
    from revisit.service.moving import move_installation

    with progress_bar(quiet=False) as bar:
        stages: dict[str, TaskID] = {}

        def advance(name: str, count: int) -> None:
            if name not in stages:
                stages[name] = bar.add_task(name, total=None)
            bar.advance(stages[name], count)

        try:
            return move_installation(source, target, advance)
        except (MoveRefused, HomeTaken, ForeignSchema, UnusableServer) as error:
            raise refuse(str(error)) from error
