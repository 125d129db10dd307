"""Copies of the working tree."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path


def copied_tree(root: Path, folder: Path) -> None:
    """Copy the files that are or would be committed, links as links; without the documentation."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        source, target = root / name, folder / name
        if name.startswith("docs/") or not (source.is_symlink() or source.is_file()):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target, follow_symlinks=False)


PACKAGES = ("core", "service", "revisit", "evaluation", "migrations", "tests/support")


def copied_packages(root: Path, folder: Path) -> None:
    """Copy what a service of the tests runs, with what was compiled of it."""
    for name in PACKAGES:
        shutil.copytree(root / name, folder / name, symlinks=True)
