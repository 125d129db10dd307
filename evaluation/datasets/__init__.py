"""Recordings on disk: published layouts and one's own clouds, read lazily. KITTI is also written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from revisit.core.errors import BadField
from revisit.core.sanity.finding import Finding
from revisit.evaluation.datasets.bag_files import bags_out_of_sight, is_bag
from revisit.evaluation.datasets.cloud_folder import open_cloud_folder, open_unposed_clouds
from revisit.evaluation.datasets.kitti import KittiRecording, write_kitti
from revisit.evaluation.datasets.kitti360 import open_kitti360
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP, Report
from revisit.evaluation.datasets.mulran import open_mulran
from revisit.evaluation.datasets.nclt import open_nclt
from revisit.evaluation.datasets.posed_clouds import PosedClouds
from revisit.evaluation.datasets.recording import Recording
from revisit.evaluation.datasets.ros_bag import BagRecording, open_bag
from revisit.evaluation.datasets.topic_choice import WantedTopics

__all__ = [
    "AUTO", "FORMATS", "KISS_ICP", "BagRecording", "KittiRecording", "PosedClouds", "Recording", "WantedTopics",
    "findings_of", "name_of_scan", "notes_of", "open_bag", "open_cloud_folder", "open_kitti360", "open_mulran",
    "open_nclt", "open_recording", "unposed_of", "with_columns", "write_kitti",
]  # fmt: skip

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "kitti": KittiRecording,
    "kitti360": open_kitti360,
    "mulran": open_mulran,
    "nclt": open_nclt,
    "clouds": open_cloud_folder,
    "rosbag2": open_bag,
    "rosbag1": open_bag,
}
"""A layout of a folder: the name given to `--format`, and its reader."""


AUTO = "auto"
"""Stands for a bag, a KITTI folder, or else any folder of clouds, by its files."""


def open_recording(
    folder: Path,
    file_format: str = AUTO,
    wanted: WantedTopics = WantedTopics(),
    poses: Path | None = None,
    report: Report | None = None,
    limit: int | None = None,
) -> Recording:
    """The recording in `folder`. `wanted` is for bags, `poses` a file of them for a folder of clouds.

    The odometry `KISS_ICP` is for both: it is made of the first `limit` clouds, and `report` is told how far it is.
    Raises BadField for an unknown format, or where topics are named and it is no bag, and what opening raises.
    """
    if wanted.odometry == KISS_ICP and not is_bag(folder):
        return _without_poses(folder, file_format, wanted, poses, report, limit)
    if poses is not None:
        if is_bag(folder) or file_format not in (AUTO, "clouds", "kitti") or wanted != WantedTopics():
            raise BadField("--poses is for folders of clouds: a bag has its poses in a topic", field="poses")
        return open_cloud_folder(folder, poses)
    if file_format == AUTO:
        return _of_what_is_there(folder, wanted, report, limit)
    if file_format not in FORMATS:
        raise BadField(f"the format is one of {', '.join((AUTO, *FORMATS))}, not {file_format[:40]!r}", field="format")
    if FORMATS[file_format] is open_bag:
        return open_bag(folder, wanted, report, limit)
    if wanted != WantedTopics():
        raise BadField("topics and the mounting of the sensor are for bags", field="topic")
    try:
        return FORMATS[file_format](folder)
    except FileNotFoundError as error:
        if error.filename is None:
            raise
        raise FileNotFoundError(
            f"a recording laid out as {file_format} has {error.filename}: it is not there"
        ) from error


def with_columns(recording: Recording, columns: tuple[str, ...]) -> Recording:
    """The recording whose scans have such columns beside their points, where its files tell them."""
    if isinstance(recording, BagRecording | PosedClouds):
        return replace(recording, columns=columns)
    return recording


def notes_of(recording: Recording) -> tuple[str, ...]:
    """Sentences on how the recording was read, where that was a choice."""
    if isinstance(recording, BagRecording):
        return recording.notes
    if not isinstance(recording, PosedClouds):
        return ()
    x, y, z = recording.origin
    moved = (f"the first pose, at {x:.3f} {y:.3f} {z:.3f}, is the origin of what is answered",)
    return (*recording.notes, *(moved if any(recording.origin) else ()))


def findings_of(recording: Recording) -> tuple[Finding, ...]:
    """Findings of the source of a recording, as times that went back before its scans were sorted."""
    return recording.findings if isinstance(recording, BagRecording) else ()


def unposed_of(recording: Recording) -> int:
    """How many scans of the source lie behind the last one of the recording, as their poses were not asked for."""
    return recording.unposed if isinstance(recording, BagRecording | PosedClouds) else 0


def name_of_scan(recording: Recording, index: int) -> str:
    """The label of a scan for a person: its file, or in a bag its number from 1 and its time."""
    if isinstance(recording, KittiRecording | PosedClouds):
        return recording.files[index].name
    return f"scan {index + 1} of {len(recording)} (stamp {recording.stamps_ns[index]} ns)"


def _without_poses(
    folder: Path,
    file_format: str,
    wanted: WantedTopics,
    poses: Path | None,
    report: Report | None,
    limit: int | None,
) -> Recording:
    """Clouds whose poses are made."""
    if poses is not None or wanted != WantedTopics(odometry=KISS_ICP):
        raise BadField(
            f"--odometry {KISS_ICP} makes the poses of a folder of clouds: no others are taken", field="poses"
        )
    if file_format not in (AUTO, "clouds", "kitti"):
        raise BadField(f"--odometry {KISS_ICP} is for folders of clouds and for bags", field="odometry")
    return open_unposed_clouds(folder, report, limit)


def _of_what_is_there(folder: Path, wanted: WantedTopics, report: Report | None, limit: int | None) -> Recording:
    try:
        return open_recording(folder, _format_of(folder), wanted, report=report, limit=limit)
    except FileNotFoundError as error:
        if advice := bags_out_of_sight(folder):
            raise FileNotFoundError(f"{error}; {advice}") from error
        raise


def _format_of(folder: Path) -> str:
    if is_bag(folder):
        return "rosbag2"
    return "kitti" if (folder / "velodyne").is_dir() and (folder / "poses.txt").is_file() else "clouds"
