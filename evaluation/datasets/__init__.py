"""Recordings on disk: published layouts and one's own clouds, read lazily. KITTI is also written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from revisit.core.errors import BadField
from revisit.evaluation.datasets.cloud_folder import open_cloud_folder
from revisit.evaluation.datasets.kitti import KittiRecording, write_kitti
from revisit.evaluation.datasets.kitti360 import open_kitti360
from revisit.evaluation.datasets.mulran import open_mulran
from revisit.evaluation.datasets.nclt import open_nclt
from revisit.evaluation.datasets.posed_clouds import PosedClouds
from revisit.evaluation.datasets.recording import Recording
from revisit.evaluation.datasets.ros_bag import open_bag

__all__ = [
    "FORMATS", "KittiRecording", "PosedClouds", "Recording", "open_bag", "open_cloud_folder", "open_kitti360",
    "open_mulran", "open_nclt", "open_recording", "write_kitti",
]  # fmt: skip

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "kitti": KittiRecording,
    "kitti360": open_kitti360,
    "mulran": open_mulran,
    "nclt": open_nclt,
    "clouds": open_cloud_folder,
    "rosbag2": open_bag,
}
"""How a folder may be laid out: the name given to `--format`, and what opens it."""


def open_recording(folder: Path, file_format: str) -> Recording:
    """The recording in `folder`. Raises BadField for an unknown format, and what opening raises."""
    if file_format not in FORMATS:
        raise BadField(f"the format is one of {', '.join(FORMATS)}, not {file_format[:40]!r}", field="format")
    return FORMATS[file_format](folder)
