"""ROS 2 bags (.mcap or .db3) with PointCloud2 and odometry, read without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.evaluation.datasets.db3 import Db3File
from revisit.evaluation.datasets.mcap import McapFile, Message, Place
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.ros_messages import CLOUD_TYPES, POSE_TYPES, read_points, read_pose, read_stamp


class Bag(Protocol):
    """A file of messages."""

    def messages(self) -> Iterator[Message]:
        """All messages, each with its place."""

    def data(self, place: Place) -> bytes:
        """The bytes of the message at a place."""


@dataclass(frozen=True)
class BagRecording:
    """The clouds of one topic with interpolated poses. A scan's points are read from the bag when asked for."""

    name: str
    bag: Bag
    places: list[Place]
    T_world_sensor: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    stamps_ns: Stamps

    def __len__(self) -> int:
        return len(self.places)

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_sensor of a scan, z up."""
        return np.asarray(self.T_world_sensor[index])

    def scan(self, index: int) -> Scan:
        """The scan with that index. Raises MalformedBody for a damaged message and what `Scan.validated` raises."""
        points = read_points(self.bag.data(self.places[index]))
        return Scan.validated(points, self.pose(index), int(self.stamps_ns[index]))

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))


@dataclass
class _Found:
    """What one topic holds."""

    stamps: list[int] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    poses: list[se3.Matrix4] = field(default_factory=list)


def open_bag(folder: Path, T_body_sensor: se3.Matrix4 | None = None) -> BagRecording:
    """A .mcap or .db3 file, or a folder with one: the topic with most clouds, the topic with most poses.

    The odometry must be the LiDAR's (z up), or `T_body_sensor` must say how the LiDAR sits on what it tracks. Clouds
    without a pose before and after them are left out. Raises FileNotFoundError, BadField, MalformedBody,
    UnsupportedEncoding.
    """
    file = _bag_file(folder)
    bag: Bag = McapFile(file) if file.suffix == ".mcap" else Db3File(file, (*CLOUD_TYPES, *POSE_TYPES))
    clouds, odometry = _topics(bag.messages())
    stamps, first = np.unique(np.array(odometry.stamps, dtype=np.int64), return_index=True)
    poses = StampedPoses(stamps, np.stack([odometry.poses[index] for index in first]))
    order = np.argsort(np.array(clouds.stamps, dtype=np.int64), kind="stable")
    cloud_stamps = np.array(clouds.stamps, dtype=np.int64)[order]
    kept = np.flatnonzero(poses.covered(cloud_stamps))
    if len(kept) == 0:
        raise BadField(f"{file.name}: no cloud was taken while there were poses", field="poses")
    mounted = np.eye(4) if T_body_sensor is None else se3.validated(T_body_sensor)
    T_world_sensor = np.stack([poses.at(int(cloud_stamps[index])) @ mounted for index in kept])
    return BagRecording(file.stem, bag, [clouds.places[order[i]] for i in kept], T_world_sensor, cloud_stamps[kept])


def _bag_file(folder: Path) -> Path:
    if folder.is_file():
        return folder
    files = sorted(file for file in folder.glob("*") if file.suffix in (".mcap", ".db3"))
    if not files:
        raise FileNotFoundError(f"no .mcap or .db3 file in {folder}")
    if len(files) > 1:
        raise BadField(f"{folder} has {len(files)} bags: merge them or name one", field="folder")
    return files[0]


def _topics(messages: Iterator[Message]) -> tuple[_Found, _Found]:
    """The fullest topic of clouds and the fullest of poses."""
    clouds: dict[str, _Found] = {}
    poses: dict[str, _Found] = {}
    for message in messages:
        if message.message_type in CLOUD_TYPES:
            found = clouds.setdefault(message.topic, _Found())
            found.places.append(message.place)
        elif message.message_type in POSE_TYPES:
            found = poses.setdefault(message.topic, _Found())
            found.poses.append(read_pose(message.data, message.message_type))
        else:
            continue
        found.stamps.append(read_stamp(message.data))
    if not clouds or not poses:
        raise BadField(f"the bag needs {' or '.join(CLOUD_TYPES)} and one of {', '.join(POSE_TYPES)}", field="topic")
    fullest = [max(found.values(), key=lambda topic: len(topic.stamps)) for found in (clouds, poses)]
    return fullest[0], fullest[1]
