"""The folder of real data that REVISIT_DATA names; its recordings are unpacked by its own script."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from revisit.evaluation.datasets import KittiRecording

VARIABLE = "REVISIT_DATA"
MISSING = f"{VARIABLE} names no folder of real data"


def has_real_data() -> bool:
    """Whether REVISIT_DATA names a folder."""
    return bool(os.environ.get(VARIABLE))


def real_data() -> Path:
    """The folder. Raises KeyError where REVISIT_DATA names none."""
    return Path(os.environ[VARIABLE])


def unpack(script: Path, name: str, target: Path) -> None:
    """Unpack the recording that lies beside `script` under this name. Raises CalledProcessError."""
    subprocess.run([sys.executable, script, name, target], check=True, stdout=subprocess.DEVNULL)


def real_recording(name: str, folder: Path) -> KittiRecording:
    """The recording of this name, unpacked into `folder` unless it lies there."""
    target = folder / name
    if not (target / "times.txt").is_file():
        unpack(real_data() / "unpack.py", name, target)
    return KittiRecording(target)
