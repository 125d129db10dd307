"""`python -m lab.storage`: bytes of a kilometre as they are coded, and of whole drives on the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lab.command_line import run
from revisit.cli.output import progress_bar, reporter, say


def kilometre(
    out: Annotated[Path, typer.Option(help="Folder for the table and unpacked recordings.")] = Path("out/bytes"),
) -> None:
    """Bytes of a kilometre, by sensor: scans, neural maps, places and descriptors."""
    from lab.storage import bytes_a_kilometre as storage

    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, scans, config in storage.drives(out):
        say(name)
        rows.append(storage.stored_bytes(name, scans, config))
    (out / "bytes.md").write_text(storage.storage_table(rows))
    say(f"{out / 'bytes.md'}")


def drives(
    out: Annotated[Path, typer.Option(help="Folder for the table, the services' data and unpacked recordings.")] = Path(
        "out/store"
    ),
) -> None:
    """Stream drives into a service each, and weigh its data as du does: blobs, database and all."""
    from lab.storage.drives import stored_drives
    from lab.storage.weighing import store_table

    out.mkdir(parents=True, exist_ok=True)
    stores = []
    with progress_bar(quiet=False) as bar:
        for one in stored_drives(out, reporter(bar)):
            stores.append(one)
            (out / "store.md").write_text(store_table(stores))
    say(f"{out / 'store.md'}")


if __name__ == "__main__":
    run(kilometre, drives)
