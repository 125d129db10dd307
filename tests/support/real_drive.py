"""Scans of the real drive that REVISIT_DATA names, unpacked by its own script: the whole would take 900 MB."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

NAME = "kitti00_head"
needs_real_drive = pytest.mark.skipif(
    "REVISIT_DATA" not in os.environ, reason="REVISIT_DATA names no folder of real recordings"
)


def unpacked_drive(folder: Path, scans: slice) -> Path:
    """These scans, with their poses, as a recording in KITTI's layout."""
    data, part = Path(os.environ["REVISIT_DATA"]), folder / "packed"
    (part / NAME).mkdir(parents=True)
    shutil.copy(data / "unpack.py", part)
    (part / NAME / f"{NAME}.rvs").symlink_to((data / NAME / f"{NAME}.rvs").resolve())
    meta = json.loads((data / NAME / f"{NAME}.json").read_text())
    poses = np.reshape(meta["poses"], (-1, 12))[scans]
    (part / NAME / f"{NAME}.json").write_text(json.dumps({"scans": meta["scans"][scans], "poses": poses.tolist()}))
    subprocess.run([sys.executable, part / "unpack.py", NAME, folder / "drive"], check=True, stdout=subprocess.DEVNULL)
    return folder / "drive"
