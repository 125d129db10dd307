"""The useful topics of a bag: of clouds, of poses, and the transforms between frames."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from revisit.core.errors import BadTransform, MalformedBody
from revisit.evaluation.datasets.bag_message import Bag, Encoding, Message, Place
from revisit.evaluation.datasets.posed_clouds import Stamps
from revisit.evaluation.datasets.ros_messages import (
    CLOUD_TYPES,
    FIX_TYPES,
    PATH_TYPES,
    POSE_TYPES,
    TRANSFORM_TYPES,
    Header,
    StampedTransform,
    read_fix,
    read_header,
    read_path,
    read_pose,
    read_transforms,
)
from revisit.evaluation.datasets.transform_groups import TransformGroups
from revisit.formats.satellite_fix import SatelliteFix

WANTED_TYPES = (*CLOUD_TYPES, *POSE_TYPES, *PATH_TYPES, *TRANSFORM_TYPES, *FIX_TYPES)


@dataclass
class CloudTopic:
    """Clouds of one topic: when and where in the bag each was found, and the frame that its header names."""

    name: str
    message_type: str
    encoding: Encoding
    stamps: list[int] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    frames: list[str] = field(default_factory=list)

    def take(self, header: Header, place: Place) -> None:
        """Note a cloud."""
        self.stamps.append(header.stamp_ns)
        self.places.append(place)
        self.frames.append(header.frame)

    @property
    def frame(self) -> str:
        """The frame that most headers name."""
        return Counter(self.frames).most_common(1)[0][0]

    def by_frame(self) -> list[CloudTopic]:
        """The clouds of each frame apart: those of several sensors may come on one topic."""
        parts: dict[str, CloudTopic] = {}
        for stamp, place, frame in zip(self.stamps, self.places, self.frames, strict=True):
            part = parts.setdefault(frame, CloudTopic(self.name, self.message_type, self.encoding))
            part.take(Header(stamp, frame), place)
        return list(parts.values())

    def first(self, count: int | None) -> CloudTopic:
        """The earliest `count` clouds by time, all for None, in the order of the bag."""
        part = CloudTopic(self.name, self.message_type, self.encoding)
        for row in np.sort(np.argsort(self.stamps_ns, kind="stable")[:count]):
            part.take(Header(self.stamps[row], self.frames[row]), self.places[row])
        return part

    @property
    def stamps_ns(self) -> Stamps:
        """Times (n,) in the order of the bag, nanoseconds."""
        return np.array(self.stamps, dtype=np.int64)


@dataclass
class PoseTopic:
    """Poses of one topic. Only an Odometry names the frame that it follows."""

    name: str
    poses: list[StampedTransform] = field(default_factory=list)

    @property
    def stamps_ns(self) -> Stamps:
        """Times (n,) in the order of the bag, nanoseconds."""
        return np.array([pose.stamp_ns for pose in self.poses], dtype=np.int64)

    @property
    def frame(self) -> str:
        """The frame the poses are told in."""
        return self.poses[0].parent

    @property
    def body(self) -> str:
        """The frame that is followed, "" where nobody says it."""
        return self.poses[0].child


@dataclass(frozen=True)
class BagTopics:
    """All that was found, with every topic's type and how many poses were no rigid motions and were left out.

    `cut` is the file that ends within a record, "" where none does; `unreadable` messages were left out, too, and
    `damaged` chunks.
    """

    clouds: dict[str, CloudTopic]
    poses: dict[str, PoseTopic]
    transforms: TransformGroups
    types: dict[str, str]
    broken_poses: int
    cut: str = ""
    unreadable: int = 0
    damaged: int = 0
    fixes: dict[str, list[SatelliteFix]] = field(default_factory=dict)
    """Fixes of satellites, by topic."""


@dataclass
class _Pass:
    """The result of one pass over the messages."""

    clouds: dict[str, CloudTopic] = field(default_factory=dict)
    poses: dict[str, PoseTopic] = field(default_factory=dict)
    transforms: TransformGroups = field(default_factory=TransformGroups)
    paths: dict[str, Message] = field(default_factory=dict)
    fixes: dict[str, list[SatelliteFix]] = field(default_factory=dict)
    broken: int = 0
    unreadable: list[str] = field(default_factory=list)

    def take(self, message: Message) -> None:
        """Note a message of use, or that it cannot be read: a damaged one does not cost the drive."""
        try:
            self._take(message)
        except BadTransform:
            # An odometry that has not started publishes zeros.
            self.broken += 1
        except MalformedBody as error:
            self.unreadable.append(f"{message.topic}: {error.message}")

    def _take(self, message: Message) -> None:
        if message.message_type in CLOUD_TYPES:
            self._cloud(message)
        elif message.message_type in POSE_TYPES:
            pose = read_pose(message.data, message.message_type, message.encoding)
            self.poses.setdefault(message.topic, PoseTopic(message.topic)).poses.append(pose)
        elif message.message_type in PATH_TYPES:
            self.paths[message.topic] = message  # each holds those before it, the last one all
        elif message.message_type in FIX_TYPES:
            self.fixes.setdefault(message.topic, []).append(read_fix(message.data, message.encoding))
        elif message.message_type in TRANSFORM_TYPES:
            self.transforms.take(message.topic, read_transforms(message.data, message.encoding))

    def finish(self) -> None:
        """Read the last message of a topic."""
        for topic, message in self.paths.items():
            try:
                poses = read_path(message.data, message.encoding)
            except BadTransform:
                self.broken += 1
                continue
            except MalformedBody as error:
                self.unreadable.append(f"{topic}: {error.message}")
                continue
            if poses:
                self.poses.setdefault(topic, PoseTopic(topic)).poses.extend(poses)

    def _cloud(self, message: Message) -> None:
        header = read_header(message.data, message.encoding)
        new = CloudTopic(message.topic, message.message_type, message.encoding)
        topic = self.clouds.setdefault(message.topic, new)
        topic.take(header, message.place)


def read_topics(bag: Bag) -> BagTopics:
    """Read a bag once, front to back. Raises MalformedBody, UnsupportedEncoding.

    Messages that cannot be read are counted; where none of the clouds, or of what moves, can, the bag is refused.
    """
    gathered = _Pass()
    for message in bag.messages():
        gathered.take(message)
    gathered.finish()
    if bag.cut and not gathered.clouds:
        raise MalformedBody(f"{bag.cut} ends within a record, before the first cloud")
    if bag.damaged and not gathered.clouds:
        raise MalformedBody(f"{bag.damaged} chunks of the bag are damaged, and there is no cloud in the others")
    lost = gathered.unreadable
    if lost and not (gathered.clouds and (gathered.poses or gathered.transforms.moving)):
        raise MalformedBody(f"{len(lost)} messages cannot be read, the first of {lost[0]}")
    return BagTopics(
        gathered.clouds, gathered.poses, gathered.transforms, dict(bag.topics), gathered.broken, bag.cut, len(lost),
        bag.damaged, gathered.fixes,
    )  # fmt: skip
