"""Bags of ROS 1 and ROS 2 (.bag, .mcap, .db3) with clouds and poses, read without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.sanity.finding import Finding
from revisit.core.scan import Points, Scan
from revisit.evaluation.datasets.bag_files import bag_files, open_files
from revisit.evaluation.datasets.bag_message import Bag, Encoding, Place
from revisit.evaluation.datasets.bag_notes import notes
from revisit.evaluation.datasets.bag_topics import WANTED_TYPES, BagTopics, read_topics
from revisit.evaluation.datasets.clock import check_clocks
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP, Report, odometry_of
from revisit.evaluation.datasets.pairing import Fixed, Pairing, Relation
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.ros_messages import read_coordinates, read_points
from revisit.evaluation.datasets.topic_choice import WantedTopics, choose, clouds_alone, with_other_frames


@dataclass(frozen=True)
class BagRecording:
    """The clouds of one topic with interpolated poses. A scan's points are read from the bag when asked for.

    T_sensor_cloud (n, 4, 4) moves the clouds as they lie in the bag into the sensor's frame; None where they are there.
    `notes` are sentences about the choice of topics; `findings` rest on the order of the bag's messages.
    """

    name: str
    bag: Bag
    places: list[Place]
    message_type: str
    encoding: Encoding
    T_world_sensor: NDArray[np.float64]
    T_sensor_cloud: NDArray[np.float64] | None
    stamps_ns: Stamps
    notes: tuple[str, ...]
    findings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.places)

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_sensor of a scan, z up."""
        return np.asarray(self.T_world_sensor[index])

    def scan(self, index: int) -> Scan:
        """The scan with that index. Raises MalformedBody for a damaged message and as `Scan.validated` does."""
        message, stamp = self.bag.data(self.places[index]), int(self.stamps_ns[index])
        if self.T_sensor_cloud is None:
            return Scan.validated(read_points(message, self.message_type, self.encoding), self.pose(index), stamp)
        # In UTM coordinates float32 has steps of 0.5 m: the points are rounded only once they are the sensor's.
        with np.errstate(over="ignore", invalid="ignore"):
            coordinates = read_coordinates(message, self.message_type, self.encoding)
            points = se3.apply(self.T_sensor_cloud[index], coordinates).astype(np.float32)
        return Scan.validated(points, self.pose(index), stamp)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))


def open_bag(path: Path, wanted: WantedTopics = WantedTopics(), report: Report | None = None) -> BagRecording:
    """A bag: one file, or a folder with one or with the files of a split one.

    Clouds and poses are chosen by their frames (`topic_choice`), unless `wanted` names them. The world must have z up.
    Clouds without a pose before and after them are left out. The odometry `KISS_ICP` is made of the clouds; `report`
    is told how far it is. Raises FileNotFoundError, BadField, BadTransform, MalformedBody, UnsupportedEncoding,
    ImportError without KISS-ICP.
    """
    if wanted.T_body_sensor is not None:
        se3.validated(wanted.T_body_sensor)
    files = bag_files(path)
    bag = open_files(files, WANTED_TYPES)
    found = read_topics(bag)
    pairs, said = _pairs(bag, found, wanted, report)
    parts = [_placed(pair) for pair in pairs]
    order = np.argsort(np.concatenate([part.stamps_ns for part in parts]), kind="stable")
    stamps, T_world_sensor = (
        np.concatenate(values)[order] for values in zip(*((p.stamps_ns, p.T_world_sensor) for p in parts), strict=True)
    )
    places = [place for part in parts for place in part.places]
    moved = parts[0].T_sensor_cloud
    name = files[0].stem if len(files) == 1 else path.resolve().name
    return BagRecording(
        name, bag, [places[index] for index in order], pairs[0].clouds.message_type, pairs[0].clouds.encoding,
        T_world_sensor,
        None if moved is None else moved[order], stamps, (*said, *notes(pairs, found, wanted, stamps, len(files))),
        tuple(check_clocks(pairs, found)),
    )  # fmt: skip


def _pairs(
    bag: Bag, found: BagTopics, wanted: WantedTopics, report: Report | None
) -> tuple[list[Pairing], Sequence[str]]:
    """The clouds with their poses, by frame, and sentences on poses that were made."""
    if wanted.odometry != KISS_ICP:
        return with_other_frames(choose(found, wanted), found, wanted), ()
    clouds = clouds_alone(found, wanted)
    order = np.argsort(clouds.stamps_ns, kind="stable")
    stamps, first = np.unique(clouds.stamps_ns[order], return_index=True)
    places = [clouds.places[index] for index in order[first]]

    def read(index: int) -> Points:
        return read_points(bag.data(places[index]), clouds.message_type, clouds.encoding)

    odometry = odometry_of(read, len(places), report)
    poses = StampedPoses(stamps, odometry.T_odom_sensor)
    why = f"KISS-ICP has found out how {clouds.frame or 'the sensor'} moved"
    here = Fixed(np.eye(4))
    return [Pairing(clouds, KISS_ICP, Relation.KNOWN, poses, here, None, why)], odometry.notes()


@dataclass(frozen=True)
class _Placed:
    """The clouds of a pairing that have a pose, in the order of the bag; T_sensor_cloud as in a BagRecording."""

    stamps_ns: Stamps
    places: list[Place]
    T_world_sensor: NDArray[np.float64]
    T_sensor_cloud: NDArray[np.float64] | None


def _placed(pair: Pairing) -> _Placed:
    kept = np.flatnonzero(pair.covered())
    stamps = pair.clouds.stamps_ns[kept]
    poses = np.stack([pair.T_world_sensor(int(stamp)) for stamp in stamps])
    return _Placed(stamps, [pair.clouds.places[index] for index in kept], poses, _into_sensor(pair, stamps, poses))


def _into_sensor(pair: Pairing, stamps: Stamps, T_world_sensor: NDArray[np.float64]) -> NDArray[np.float64] | None:
    if pair.cloud_frame is None:
        return None
    T_world_cloud = [pair.cloud_frame.at(int(stamp)) for stamp in stamps]
    return np.stack([se3.inverse(pose) @ cloud for pose, cloud in zip(T_world_sensor, T_world_cloud, strict=True)])
