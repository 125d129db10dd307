"""Clouds of a bag with their poses, and those of several LiDARs merged sweep by sweep."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.deskew import SweepMotion, deskewed, knots
from revisit.core.point_columns import TIME
from revisit.core.scan import Points
from revisit.evaluation.datasets.bag_message import Bag, Encoding, Place
from revisit.evaluation.datasets.pairing import Pairing
from revisit.evaluation.datasets.posed_clouds import Stamps
from revisit.evaluation.datasets.ros_messages import read_columns, read_coordinates, read_points, read_sweep
from revisit.formats import DecodedCloud

_DESKEWED = re.compile(r"deskew|undistort|compensat|registered|corrected", re.IGNORECASE)
"""Clouds on topics that are called so were deskewed by their publisher."""


@dataclass(frozen=True)
class BagCloud:
    """A cloud as it lies in a bag, taken at `stamp_ns` by the sensor whose `motion` is known.

    T_scan_cloud (4, 4) moves it into the frame of its scan; None where it is there. With `motion` None it is not
    deskewed.
    """

    place: Place
    message_type: str
    encoding: Encoding
    stamp_ns: int
    T_scan_cloud: se3.Matrix4 | None = None
    motion: Pairing | None = None

    def read(self, bag: Bag, wanted: Collection[str], stamp_ns: int) -> DecodedCloud:
        """The points in the frame of the scan, with the wanted columns that the cloud has; times since `stamp_ns`.

        Raises MalformedBody, BadField, TooLarge.
        """
        message = bag.data(self.place)
        columns = dict(read_columns(message, self.message_type, wanted, self.encoding)) if wanted else {}
        if TIME.name in columns:
            columns[TIME.name] = columns[TIME.name] + (self.stamp_ns - stamp_ns)
        return DecodedCloud(self._points(message), columns)

    def sweep(self, bag: Bag) -> NDArray[np.float64] | None:
        """The deskewed points (n, 3), in the sensor's frame at the stamp; None where points have no times."""
        return self._sweep(bag.data(self.place))

    def _points(self, message: bytes) -> Points:
        sweep = self._sweep(message)
        if sweep is None and self.T_scan_cloud is None:
            return read_points(message, self.message_type, self.encoding)
        # In UTM coordinates float32 has steps of 0.5 m: the points are rounded only once they are the sensor's.
        with np.errstate(over="ignore", invalid="ignore"):
            coordinates = read_coordinates(message, self.message_type, self.encoding) if sweep is None else sweep
            moved = coordinates if self.T_scan_cloud is None else se3.apply(self.T_scan_cloud, coordinates)
            return moved.astype(np.float32)

    def _sweep(self, message: bytes) -> NDArray[np.float64] | None:
        told = None if self.motion is None else read_sweep(message, self.message_type, self.encoding)
        if told is None or self.motion is None:
            return None
        motion = _motion(self.motion, self.stamp_ns, knots(told.offsets_ns))
        with np.errstate(over="ignore", invalid="ignore"):
            return deskewed(told.points, told.offsets_ns, motion)


def _motion(pair: Pairing, stamp_ns: int, offsets_ns: NDArray[np.int64]) -> SweepMotion:
    """Where the sensor was at such times since the stamp; where that is not known, as long as it is."""
    known = np.flatnonzero(pair.covers(stamp_ns + offsets_ns))
    times = offsets_ns[known] if len(known) else np.zeros(1, dtype=np.int64)
    held = np.clip(offsets_ns, times[0], times[-1])
    T_scan_world = se3.inverse(pair.T_world_sensor(stamp_ns))
    return SweepMotion(offsets_ns, np.stack([T_scan_world @ pair.T_world_sensor(stamp_ns + int(at)) for at in held]))


@dataclass(frozen=True)
class PlacedClouds:
    """Clouds by rising time: stamps_ns (n,), the clouds of each scan, and T_world_sensor (n, 4, 4)."""

    stamps_ns: Stamps
    clouds: Sequence[tuple[BagCloud, ...]]
    T_world_sensor: NDArray[np.float64]


@dataclass(frozen=True)
class Merged:
    """Scans of one LiDAR with the clouds of others in them.

    `taken` is how many clouds of each other one are in a scan, of so many `offered`; `apart_ns` is the longest time
    between two stamps of a scan, `reach_ns` the longest that there may be.
    """

    scans: PlacedClouds
    taken: tuple[int, ...]
    offered: tuple[int, ...]
    apart_ns: int
    reach_ns: int


def placed(pairs: Sequence[Pairing], deskew: bool = True) -> PlacedClouds:
    """The clouds that have a pose, of pairs that differ in the frame of their clouds alone.

    With `deskew` those of sensors are deskewed where their points have times; somebody has done so with others.
    """
    stamps, clouds, poses = [], [], []
    for pair in pairs:
        for index in np.flatnonzero(pair.covered()):
            stamp = int(pair.clouds.stamps_ns[index])
            stamps.append(stamp)
            poses.append(pair.T_world_sensor(stamp))
            clouds.append((_cloud(pair, int(index), poses[-1], deskew),))
    order = np.argsort(np.array(stamps, dtype=np.int64), kind="stable")
    times = np.array(stamps, dtype=np.int64)[order]
    return PlacedClouds(times, [clouds[index] for index in order], np.array(poses).reshape(-1, 4, 4)[order])


def _cloud(pair: Pairing, index: int, T_world_sensor: se3.Matrix4, deskew: bool) -> BagCloud:
    """A cloud of a pair; one that somebody has moved into another frame is taken back to its sensor."""
    clouds, stamp = pair.clouds, int(pair.clouds.stamps_ns[index])
    cloud = BagCloud(clouds.places[index], clouds.message_type, clouds.encoding, stamp)
    if pair.cloud_frame is not None:
        return replace(cloud, T_scan_cloud=se3.inverse(T_world_sensor) @ pair.cloud_frame.at(stamp))
    return replace(cloud, motion=pair) if deskew and not _DESKEWED.search(clouds.name) else cloud


def merged(first: PlacedClouds, others: Sequence[PlacedClouds]) -> Merged:
    """Each scan of the first LiDAR with the nearest cloud of each other one, at most half a period of the first away.

    The scan keeps the frame, the time and the pose of the first one. The poses of both times lie between the two
    clouds: the mounting of each LiDAR, and the way that the robot drove meanwhile.
    """
    reach = int(np.median(np.diff(first.stamps_ns))) // 2 if len(first.stamps_ns) > 1 else 0
    scans, taken, apart = [list(clouds) for clouds in first.clouds], [], 0
    for other in others:
        nearest = _nearest(first.stamps_ns, other.stamps_ns, reach)
        for index in np.flatnonzero(nearest >= 0):
            partner = int(nearest[index])
            T_scan_cloud = se3.inverse(first.T_world_sensor[index]) @ other.T_world_sensor[partner]
            scans[index] += [replace(cloud, T_scan_cloud=T_scan_cloud) for cloud in other.clouds[partner]]
            apart = max(apart, abs(int(first.stamps_ns[index]) - int(other.stamps_ns[partner])))
        taken.append(int((nearest >= 0).sum()))
    joined = replace(first, clouds=[tuple(clouds) for clouds in scans])
    return Merged(joined, tuple(taken), tuple(len(other.stamps_ns) for other in others), apart, reach)


def _nearest(stamps_ns: Stamps, others_ns: Stamps, reach_ns: int) -> NDArray[np.int64]:
    """For each of the rising times (n,) the number of the nearest of the others (m,), -1 where none is within reach.

    Each of the others belongs to the one time that is nearest to it.
    """
    chosen = np.full(len(stamps_ns), -1, dtype=np.int64)
    after = np.clip(np.searchsorted(stamps_ns, others_ns), 1, max(len(stamps_ns) - 1, 1))
    earlier = others_ns - stamps_ns[after - 1] <= np.abs(stamps_ns[np.minimum(after, len(stamps_ns) - 1)] - others_ns)
    owner = np.where(earlier, after - 1, after)
    apart = np.abs(stamps_ns[owner] - others_ns)
    for other in np.argsort(-apart, kind="stable"):
        if apart[other] <= reach_ns:
            chosen[owner[other]] = other
    return chosen
