"""Bags of ROS 1 and ROS 2 (.bag, .mcap, .db3) with clouds and poses, read without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.point_columns import USUAL, joined
from revisit.core.sanity.finding import Finding
from revisit.core.scan import Points, Scan
from revisit.evaluation.datasets.bag_files import bag_files, open_files
from revisit.evaluation.datasets.bag_message import Bag
from revisit.evaluation.datasets.bag_notes import notes, notes_of_deskewing, notes_of_merged
from revisit.evaluation.datasets.bag_topics import WANTED_TYPES, BagTopics, read_topics
from revisit.evaluation.datasets.clock import check_clocks
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP, Report, odometry_of
from revisit.evaluation.datasets.pairing import Fixed, Pairing, Relation
from revisit.evaluation.datasets.placed_clouds import BagCloud, merged, placed
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.ros_messages import read_points
from revisit.evaluation.datasets.topic_choice import (
    WantedTopics,
    choose,
    choose_beside,
    clouds_alone,
    with_other_frames,
)
from revisit.formats.satellite_fix import SatelliteFix


@dataclass(frozen=True)
class BagRecording:
    """The clouds of one topic, or of several LiDARs together, with interpolated poses.

    A scan's points are read from the bag when asked for: `clouds` are those that each scan consists of.
    `notes` are sentences about the choice of topics; `findings` rest on the order of the bag's messages. `fixes` of
    satellites are by topic. `unposed` is the number of clouds behind these whose poses nobody made. `columns` are those
    of the points that are read: of several LiDARs, those that all have.
    """

    name: str
    bag: Bag
    clouds: Sequence[tuple[BagCloud, ...]]
    T_world_sensor: NDArray[np.float64]
    stamps_ns: Stamps
    notes: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    fixes: Mapping[str, Sequence[SatelliteFix]] = field(default_factory=dict)
    unposed: int = 0
    columns: tuple[str, ...] = USUAL

    def __len__(self) -> int:
        return len(self.clouds)

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_sensor of a scan, z up."""
        return np.asarray(self.T_world_sensor[index])

    def scan(self, index: int) -> Scan:
        """The scan with that index. Raises MalformedBody for a damaged message and as `Scan.validated` does."""
        stamp_ns = int(self.stamps_ns[index])
        parts = [cloud.read(self.bag, self.columns, stamp_ns) for cloud in self.clouds[index]]
        points = parts[0].points if len(parts) == 1 else np.concatenate([part.points for part in parts])
        return Scan.validated(points, self.pose(index), stamp_ns, joined([part.columns for part in parts]))

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))


def open_bag(
    path: Path, wanted: WantedTopics = WantedTopics(), report: Report | None = None, limit: int | None = None
) -> BagRecording:
    """A bag: one file, or a folder with one or with the files of a split one.

    Clouds and poses are chosen by their frames (`topic_choice`), unless `wanted` names them. The world must have z up.
    Clouds without a pose before and after them are left out. Topics that are `wanted` together are merged sweep by
    sweep (`placed_clouds`). The odometry `KISS_ICP` is made of the clouds, of the first `limit` of them; `report` is
    told how far it is. Raises FileNotFoundError, BadField, BadTransform, MalformedBody, UnsupportedEncoding,
    ImportError without KISS-ICP.
    """
    if wanted.T_body_sensor is not None:
        se3.validated(wanted.T_body_sensor)
    files = bag_files(path)
    bag = open_files(files, WANTED_TYPES)
    found = read_topics(bag)
    pairs, said, unposed = _pairs(bag, found, wanted, report, limit)
    scans = placed(pairs, wanted.deskew)
    others = [with_other_frames(pair, found, wanted) for pair in choose_beside(pairs[0], found, wanted)]
    together = merged(scans, [placed(other, wanted.deskew) for other in others])
    told = [*notes(pairs, found, wanted, scans.stamps_ns, len(files)), *notes_of_merged(others, together, found)]
    told += notes_of_deskewing(bag, scans)
    return BagRecording(
        files[0].stem if len(files) == 1 else path.resolve().name,
        bag, together.scans.clouds, scans.T_world_sensor, scans.stamps_ns, (*said, *told),
        tuple(check_clocks([pair for topic in (pairs, *others) for pair in topic], found)),
        found.fixes, unposed,
    )  # fmt: skip


def _pairs(
    bag: Bag, found: BagTopics, wanted: WantedTopics, report: Report | None, limit: int | None
) -> tuple[list[Pairing], Sequence[str], int]:
    """The clouds with their poses, by frame; sentences on poses that were made; how many clouds got none."""
    if wanted.odometry != KISS_ICP:
        return with_other_frames(choose(found, wanted), found, wanted), (), 0
    every = clouds_alone(found, wanted)
    clouds = every.first(limit)
    order = np.argsort(clouds.stamps_ns, kind="stable")
    stamps, first = np.unique(clouds.stamps_ns[order], return_index=True)
    places = [clouds.places[index] for index in order[first]]

    def read(index: int) -> Points:
        return read_points(bag.data(places[index]), clouds.message_type, clouds.encoding)

    odometry = odometry_of(read, len(places), report)
    poses = StampedPoses(stamps, odometry.T_odom_sensor)
    why = f"KISS-ICP has found out how {clouds.frame or 'the sensor'} moved"
    here = Fixed(np.eye(4))
    unposed = len(every.stamps) - len(clouds.stamps)
    return [Pairing(clouds, KISS_ICP, Relation.KNOWN, poses, here, None, why)], odometry.notes(), unposed
