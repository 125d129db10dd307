"""Store and API of this release, kept for later ones: `python -m tests.compatibility.write`, once a release."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

from tests.faults.drive import undisturbed

ROOT = Path(__file__).resolve().parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
STORES = Path(__file__).parent / "stores"
APIS = Path(__file__).parent / "apis"
REFERENCE = ROOT / "docs/reference"
NAMES = {
    "sdk.md": r"\bclient(?:\.\w+)+",
    "cli.md": r"(?<=^## )revisit .+$",
    "settings.md": r"(?<=^### )REVISIT_\w+$",
    "errors.md": r"(?<=^## )[A-Z_]+$",
}
"""Page of the reference that is written from the code -> the names on it that users write."""

THE_SAME_TIME = (2026, 1, 1, 0, 0, 0)


def buf(*words: str, proto: Path = ROOT / "proto") -> subprocess.CompletedProcess[str]:
    """Run buf of this environment in a folder of proto files."""
    command = [str(Path(sys.executable).parent / "buf"), *words]
    return subprocess.run(command, cwd=proto, capture_output=True, text=True, check=False)


def write_api(file: Path) -> None:
    """The descriptors of all messages and calls, without their comments."""
    built = buf("build", "--exclude-source-info", "-o", str(file))
    if built.returncode:
        raise RuntimeError(built.stderr)


def public_names() -> set[str]:
    """Methods of the SDK, commands, settings and error codes of this version."""
    pages = {page: (REFERENCE / page).read_text().partition("## For tests")[0] for page in NAMES}
    return {name for page, words in NAMES.items() for name in re.findall(words, pages[page], re.MULTILINE)}


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
    write_store(STORES / f"release-{VERSION}.zip")
    write_api(APIS / f"release-{VERSION}.binpb")
    (APIS / f"release-{VERSION}.txt").write_text("\n".join(sorted(public_names())) + "\n")
