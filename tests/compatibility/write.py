"""Store and API of this release, kept for later ones: `python -m tests.compatibility.write`, once a release."""

from __future__ import annotations

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
