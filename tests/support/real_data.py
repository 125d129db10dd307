"""Real data in tests: what skips a test that has none, and a part of the real drive, whose whole takes 900 MB."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from revisit.evaluation.real_data import MISSING, has_real_data, real_data, unpack

NAME = "kitti00_head"
needs_real_data = pytest.mark.skipif(not has_real_data(), reason=MISSING)


def unpacked_drive(folder: Path, scans: slice) -> Path:
    """These scans, with their poses, as a recording in KITTI's layout."""
    data, part = real_data(), folder / "packed"
    (part / NAME).mkdir(parents=True)
    shutil.copy(data / "unpack.py", part)
    (part / NAME / f"{NAME}.rvs").symlink_to((data / NAME / f"{NAME}.rvs").resolve())
    meta = json.loads((data / NAME / f"{NAME}.json").read_text())
    poses = np.reshape(meta["poses"], (-1, 12))[scans]
    (part / NAME / f"{NAME}.json").write_text(json.dumps({"scans": meta["scans"][scans], "poses": poses.tolist()}))
    unpack(part / "unpack.py", NAME, folder / "drive")
    return folder / "drive"
