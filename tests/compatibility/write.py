"""Make the store that later versions must open: `python -m tests.compatibility.write`, once a release."""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path

from tests.faults.drive import undisturbed

ROOT = Path(__file__).resolve().parents[2]
STORES = Path(__file__).parent / "stores"
THE_SAME_TIME = (2026, 1, 1, 0, 0, 0)


def newest_schema() -> str:
    """The number of the last migration."""
    return max(path.name[:4] for path in (ROOT / "migrations/versions").glob("[0-9]*.py"))


def write_store(file: Path) -> None:
    """A drive through every step of the service: the folder `home` as it is left, and the robots' `log` beside it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "home").mkdir()
        undisturbed(folder / "home", folder / "log")
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(path for path in folder.rglob("*") if path.is_file()):
                entry = zipfile.ZipInfo(path.relative_to(folder).as_posix(), THE_SAME_TIME)
                archive.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)


if __name__ == "__main__":
    write_store(STORES / f"schema-{newest_schema()}.zip")
