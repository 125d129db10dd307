"""`revisit backup`, `restore` and `scrub`: looking after a data folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from revisit.cli.extras import needs
from revisit.cli.offline import bucket_of, data_folder
from revisit.cli.options import Home, Json
from revisit.cli.output import emit_json, refuse


@needs("service")
def backup(
    out: Annotated[Path, typer.Argument(help="The folder to make.")], home: Home = None, json: Json = False
) -> None:
    """Back up the data folder into a new folder, while the service runs; exit status 1 where a blob or row is lost."""
    from revisit.service import VERSION
    from revisit.service.engines.local.sqlite.backup import make_backup

    manifest = make_backup(data_folder(home), out, VERSION, bucket_of(home))
    size_mb = manifest.blob_bytes / 2**20
    text = f"{out}: schema {manifest.revision}, {manifest.blobs} blobs of {size_mb:.1f} MiB"
    _tell(text, asdict(manifest), json)
    _report({"lost before this backup": manifest.lost})


@needs("service")
def restore(
    archive: Annotated[Path, typer.Argument(exists=True, file_okay=False, help="A backup.")],
    home: Home = None,
    key: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="The key that signed it: `backup.key` of the old data folder."),
    ] = None,
    unsigned: Annotated[
        bool, typer.Option("--unsigned", help="Take it without a key, whoever may have changed it.")
    ] = False,
    json: Json = False,
) -> None:
    """Make a new data folder out of a backup, after checking its signature and every hash; all of it or nothing."""
    from revisit.service.engines.local.files.secret_files import read_secret
    from revisit.service.engines.local.sqlite.backup import restore_backup

    if (key is None) != unsigned:
        raise refuse("give the key that signed the backup (--key backup.key), or --unsigned where it is lost")
    target = data_folder(home)
    manifest = restore_backup(archive, target, None if key is None else read_secret(key), bucket_of(home))
    _tell(f"{target}: as of {manifest.created_at}, {manifest.blobs} blobs", asdict(manifest), json)


@needs("service")
def scrub(home: Home = None, json: Json = False) -> None:
    """Read every blob, page and row, move damaged blobs aside; exit status 1 where anything is damaged or missing."""
    from revisit.service.engines.local.sqlite import examination

    found = examination.scrub(data_folder(home), bucket_of(home))
    _tell(f"{found.checked} blobs read, database {found.database}", asdict(found), json)
    named = {"damaged, moved aside": found.damaged, "missing": found.missing, "not what was written": found.rows}
    _report(named, damaged=found.database != "ok")


def _tell(text: str, data: dict[str, object], as_json: bool) -> None:
    if as_json:
        emit_json(data)
    else:
        typer.echo(text)


def _report(found: dict[str, tuple[str, ...]], *, damaged: bool = False) -> None:
    """Print all that was found; exit status 1 where there is anything, or something is `damaged` beside it."""
    for what, names in found.items():
        for name in names:
            typer.echo(f"{what}: {name}", err=True)
    if damaged or any(found.values()):
        raise typer.Exit(1)
