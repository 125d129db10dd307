"""Clouds with poses, of a pair of topics of a bag."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.evaluation.datasets.bag_topics import CloudTopic
from revisit.evaluation.datasets.namespaces import shared
from revisit.evaluation.datasets.posed_clouds import Stamps
from revisit.evaluation.datasets.transform_tree import TransformTree


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
    they are taken back into the sensor's. `why` and the `warnings` are sentences for people.
    """

    clouds: CloudTopic
    poses: str
    relation: Relation
    body: PoseSource
    mounting: PoseSource
    cloud_frame: PoseSource | None
    why: str
    warnings: tuple[str, ...] = ()

    @property
    def common_segments(self) -> int:
        """How many segments the namespaces of the clouds and of the poses have in common."""
        return max(shared(self.clouds.name, topic) for topic in self.poses.split(", "))

    def shares_poses(self, other: Pairing) -> bool:
        """Whether both are placed in one world by the same poses, and as surely."""
        worlds = [pair.body.target if isinstance(pair.body, BetweenFrames) else "" for pair in (self, other)]
        return (self.poses, self.relation, worlds[0]) == (other.poses, other.relation, worlds[1])

    def stamps_ns(self) -> list[Stamps]:
        """The times of each transform in use that moves, in the order of the bag."""
        ways = [part for part in (self.body, self.mounting, self.cloud_frame) if isinstance(part, BetweenFrames)]
        return [stamps for way in ways for stamps in way.tree.stamps_ns(way.target, way.source)]

    def covered(self) -> NDArray[np.bool_]:
        """For which clouds all that is needed is known."""
        return self.covers(self.clouds.stamps_ns)

    def covers(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """At which of the times (n,) all that is needed is known."""
        parts = [self.body, self.mounting] + ([] if self.cloud_frame is None else [self.cloud_frame])
        return np.asarray(np.logical_and.reduce([part.covered(stamps_ns) for part in parts]))

    def T_world_sensor(self, stamp_ns: int) -> se3.Matrix4:
        """The pose of the sensor at a covered time."""
        return self.body.at(stamp_ns) @ self.mounting.at(stamp_ns)
