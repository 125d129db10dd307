"""A finished session is known again by the length of its way, as each release has counted it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from revisit.cli.resuming import require_stored
from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.scan import CloudReport, Scan
from revisit.core.scan_marks import ScanMarks, way_along
from revisit.sdk.errors import FailedPrecondition

SCANS = 60
POINTS = np.random.default_rng(1).uniform(-20.0, 20.0, (2_000, 3)).astype(np.float32)
POSES = [
    se3.from_yaw(0.0, where + (0.03 * row, 0.0, 0.0))
    for row, where in enumerate(np.random.default_rng(2).normal(0.0, 0.01, (SCANS, 3)))
]
"""A slow robot whose poses tremble by a centimetre: 1.7 m in steps, 2.2 m pose by pose."""
RECORDING = SimpleNamespace(
    name="slow",
    stamps_ns=np.arange(SCANS, dtype=np.int64),
    pose=POSES.__getitem__,
    scan=lambda row: Scan.posed(POINTS, CloudReport(0, False), POSES[row], row),
)
CLIENT = SimpleNamespace(get_map=lambda _: SimpleNamespace(tau_m=10.0), list_submaps=lambda _: [])


def session(travelled_m: float) -> SimpleNamespace:
    """A session that has all scans, of a way that long."""
    counts = {"committed_seq": SCANS, "committed_stamp_ns": SCANS - 1}
    return SimpleNamespace(name="maps/town/sessions/slow", travelled_m=travelled_m, **counts)


def pose_by_pose_m() -> float:
    """As services counted before there was a least step."""
    return float(np.linalg.norm(np.diff([pose[:3, 3] for pose in POSES], axis=0), axis=1).sum())


def test_a_session_is_known_again_whichever_release_has_counted_its_way():
    counted_m = way_along(POSES, ScanMarks.of(SubmapConfig())).travelled_m
    assert pose_by_pose_m() > counted_m + 0.3
    for way_m in (counted_m, pose_by_pose_m()):
        require_stored(CLIENT, session(way_m), RECORDING, SCANS)


@pytest.mark.parametrize("off_m", [-0.4, 0.4])
def test_a_session_of_another_way_is_another_recording(off_m):
    """Shorter than in steps, or longer than pose by pose."""
    counted_m = way_along(POSES, ScanMarks.of(SubmapConfig())).travelled_m
    with pytest.raises(FailedPrecondition, match="does not hold this recording"):
        require_stored(CLIENT, session((counted_m if off_m < 0 else pose_by_pose_m()) + off_m), RECORDING, SCANS)
