"""Which clouds and which poses of a bag belong together: decided by their frames, and said."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets.bag_topics import BagTopics, CloudTopic, PoseTopic
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.transform_tree import TransformTree, stamped_poses

TF = "/tf"
ODOMETRY_FRAMES = ("odom", "odom_combined", "camera_init")
_LIDAR_ODOMETRY = re.compile(r"kiss|icp|lio|loam|lidar", re.IGNORECASE)
_LIVOX = "CustomMsg"
_PACKETS = ("VelodyneScan", "PacketMsg", "RobosensePacket", "RslidarScan", "HesaiScan", "PandarScan")


@dataclass(frozen=True)
class WantedTopics:
    """What the user says about a bag; the rest is found out."""

    topic: str | None = None
    odometry: str | None = None
    T_body_sensor: se3.Matrix4 | None = None


class Relation(IntEnum):
    """How the clouds lie in the frame that the poses follow; the surer the smaller."""

    KNOWN = 0
    BY_TRANSFORMS = 1
    ASSUMED = 2
    REGISTERED = 3


class PoseSource(Protocol):
    """Poses of a frame by time."""

    def covered(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """At which of the times the pose is known."""

    def at(self, stamp_ns: int) -> se3.Matrix4:
        """T_world_frame at a covered time."""


@dataclass(frozen=True)
class BetweenFrames:
    """Where the frame `source` is in the frame `target`, by the bag's transforms."""

    tree: TransformTree
    target: str
    source: str

    def covered(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """At which of the times every transform on the way is known."""
        return self.tree.covered(self.target, self.source, stamps_ns)

    def at(self, stamp_ns: int) -> se3.Matrix4:
        """T_target_source."""
        return self.tree.at(self.target, self.source, stamp_ns)


@dataclass(frozen=True)
class Fixed:
    """A pose that does not change."""

    T_world_frame: se3.Matrix4

    def covered(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """Always."""
        return np.ones(len(stamps_ns), dtype=bool)

    def at(self, stamp_ns: int) -> se3.Matrix4:
        """The pose."""
        return self.T_world_frame


@dataclass(frozen=True)
class Pairing:
    """Clouds with their poses: T_world_sensor = body @ mounting at a cloud's time.

    `cloud_frame` is None for clouds in the sensor's frame; else it is where their frame lies in the world, from which
    they are taken back into the sensor's. `why` is a sentence for people.
    """

    clouds: CloudTopic
    poses: str
    relation: Relation
    body: PoseSource
    mounting: PoseSource
    cloud_frame: PoseSource | None
    why: str

    def covered(self) -> NDArray[np.bool_]:
        """For which clouds all that is needed is known."""
        stamps = self.clouds.stamps_ns
        parts = [self.body, self.mounting] + ([] if self.cloud_frame is None else [self.cloud_frame])
        return np.asarray(np.logical_and.reduce([part.covered(stamps) for part in parts]))

    def T_world_sensor(self, stamp_ns: int) -> se3.Matrix4:
        """The pose of the sensor at a covered time."""
        return self.body.at(stamp_ns) @ self.mounting.at(stamp_ns)


def choose(found: BagTopics, wanted: WantedTopics) -> Pairing:
    """The pair of topics whose frames fit best; among equals the one with most clouds that have a pose.

    Among equals again poses that a LiDAR odometry publishes go before those of wheels, told by the topic's name. A pair
    that has poses for less than half as many clouds as another one is no choice. Raises BadField, with advice, where
    there is none.
    """
    clouds = _named(found.clouds, wanted.topic, "topic", found)
    pairs = [pair for cloud in clouds for pair in _pairings(cloud, found, wanted)]
    if not pairs:
        raise BadField(_no_poses(found, clouds, wanted), field="odometry")
    counts = [int(pair.covered().sum()) for pair in pairs]
    if max(counts) == 0:
        raise BadField(f"no cloud of {pairs[0].clouds.name} was taken while there were poses of {pairs[0].poses}: "
                       "are both stamped by one clock?", field="poses")  # fmt: skip
    usable = [(pair, count) for pair, count in zip(pairs, counts, strict=True) if 2 * count >= max(counts)]
    return min(usable, key=lambda choice: (choice[0].relation, -choice[1], *_precision(choice[0], found)))[0]


def _precision(pair: Pairing, found: BagTopics) -> tuple[bool, int]:
    """The smaller, the better the poses are likely to be."""
    samples = len(found.poses[pair.poses].poses) if pair.poses in found.poses else 0
    return not _LIDAR_ODOMETRY.search(pair.poses), -samples


def _named(topics: dict[str, CloudTopic], name: str | None, field: str, found: BagTopics) -> list[CloudTopic]:
    if not topics:
        raise BadField(_no_clouds(found), field="topic")
    if name is None:
        return list(topics.values())
    if name not in topics:
        raise BadField(f"no clouds on {name[:80]}; there are some on {', '.join(sorted(topics))}", field=field)
    return [topics[name]]


def _pairings(cloud: CloudTopic, found: BagTopics, wanted: WantedTopics) -> Iterator[Pairing]:
    """What the clouds may be paired with."""
    if wanted.odometry not in (None, TF, *found.poses):
        there = ", ".join(sorted(found.poses)) or "none"
        raise BadField(f"no poses on {str(wanted.odometry)[:80]}; topics with poses: {there}", field="odometry")
    for topic in found.poses.values():
        if wanted.odometry in (None, topic.name):
            yield _with_odometry(cloud, topic, found.tree, wanted)
    root = _fixed_frame(cloud.frame, found.tree)
    if root is not None and wanted.odometry in (None, TF):
        way = BetweenFrames(found.tree, root, cloud.frame)
        mounting = Fixed(np.eye(4) if wanted.T_body_sensor is None else wanted.T_body_sensor)
        why = f"the transforms tell where {cloud.frame} is in {root}"
        yield Pairing(cloud, TF, Relation.BY_TRANSFORMS, way, mounting, None, why)


def _fixed_frame(frame: str, tree: TransformTree) -> str | None:
    """The frame that stands still: an odometry's above `frame`, else the topmost, if anything moves in it."""
    above = tree.ancestors(frame)
    moving = [ancestor for ancestor in above if tree.moves(ancestor, frame)]
    return next((ancestor for ancestor in moving if ancestor in ODOMETRY_FRAMES), moving[-1] if moving else None)


def _with_odometry(cloud: CloudTopic, topic: PoseTopic, tree: TransformTree, wanted: WantedTopics) -> Pairing:
    poses = stamped_poses(topic.poses)
    given = wanted.T_body_sensor
    mounting: PoseSource = Fixed(np.eye(4) if given is None else given)
    if cloud.frame and (cloud.frame == topic.frame or cloud.frame in tree.ancestors(topic.frame)):
        return _registered(cloud, topic, poses, mounting, tree)
    relation, why = Relation.KNOWN, f"the clouds are in {cloud.frame}, which the poses follow"
    if given is not None:
        why = "--T-body-sensor says how the sensor sits on what the poses follow"
    elif topic.body != cloud.frame and topic.body and tree.linked(topic.body, cloud.frame):
        mounting = BetweenFrames(tree, topic.body, cloud.frame)
        why = f"the transforms tell where {cloud.frame} is in {topic.body}, which the poses follow"
    elif topic.body != cloud.frame:
        relation = Relation.ASSUMED
        why = (
            f"nothing tells where {cloud.frame or 'the sensor'} is in {topic.body or 'what the poses follow'}: "
            "taken as the same; else say it with --T-body-sensor"
        )
    return Pairing(cloud, topic.name, relation, poses, mounting, None, why)


def _registered(
    cloud: CloudTopic, topic: PoseTopic, poses: StampedPoses, mounting: PoseSource, tree: TransformTree
) -> Pairing:
    """Clouds that somebody has already moved into the frame of the poses, or into one above it."""
    why = f"the clouds are registered in {cloud.frame}: each is taken back to its sensor by the inverse of its pose"
    frame: PoseSource = Fixed(np.eye(4))
    if cloud.frame != topic.frame:
        frame = BetweenFrames(tree, topic.frame, cloud.frame)
    return Pairing(cloud, topic.name, Relation.REGISTERED, poses, mounting, frame, why)


def _no_clouds(found: BagTopics) -> str:
    livox = [topic for topic, kind in found.types.items() if kind.endswith(_LIVOX)]
    if livox:
        return (
            f"{livox[0]} holds clouds in the driver's own {_LIVOX}: record sensor_msgs/PointCloud2 instead "
            "(xfer_format 0 in the Livox driver), or the odometry's output"
        )
    packets = [topic for topic, kind in found.types.items() if kind.endswith(_PACKETS)]
    if packets:
        return (
            f"{packets[0]} holds packets as the sensor sends them: play the bag into the driver's converter (Velodyne: "
            "velodyne_pointcloud, Ouster: os_cloud) and record the sensor_msgs/PointCloud2 that it publishes"
        )
    if any(kind.endswith("/LaserScan") for kind in found.types.values()):
        return f"the bag has scans of one plane alone (LaserScan): a 3D LiDAR is needed. Topics: {_listed(found)}"
    return f"no sensor_msgs/PointCloud2 in the bag; its topics: {_listed(found)}"


def _no_poses(found: BagTopics, clouds: list[CloudTopic], wanted: WantedTopics) -> str:
    cloud = clouds[0]
    if wanted.odometry == TF:
        return f"the transforms do not tell how {cloud.frame or 'the sensor'} moves: {_listed(found)}"
    if found.broken_poses and not found.poses:
        return (
            f"{cloud.name} (frame {cloud.frame}) has no poses: all {found.broken_poses} in the bag are no rigid "
            "motions. They hold NaN, or quaternions (x, y, z, w) that are not of length 1"
        )
    return (
        f"{cloud.name} (frame {cloud.frame}) has no poses: the bag needs a nav_msgs/Odometry, a nav_msgs/Path, a "
        f"geometry_msgs/PoseStamped, or transforms above {cloud.frame} that move. Run a LiDAR odometry (KISS-ICP, "
        "FAST-LIO) and record what it publishes, or give clouds and a TUM trajectory to `--format clouds`. "
        f"Topics: {_listed(found)}"
    )


def _listed(found: BagTopics) -> str:
    topics = [f"{topic} ({kind})" for topic, kind in sorted(found.types.items())]
    return ", ".join(topics[:20]) + (f" and {len(topics) - 20} more" if len(topics) > 20 else "")
