"""Which clouds and which poses of a bag belong together: decided by their frames, and said."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets.bag_topics import BagTopics, CloudTopic, PoseTopic
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP
from revisit.evaluation.datasets.namespaces import alike, of_another_robot, shared, twins
from revisit.evaluation.datasets.pairing import BetweenFrames, Fixed, Pairing, PoseSource, Relation
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.ros_messages import CLOUD_TYPES, PATH_TYPES, POSE_TYPES
from revisit.evaluation.datasets.transform_tree import TransformTree, stamped_poses

TF = "/tf"
ODOMETRY_FRAMES = ("odom", "odom_combined", "camera_init")
SAME_MOUNTING_M, SAME_MOUNTING_DEG = 0.02, 0.5
"""A mounting that is given is taken for the one that the transforms tell up to this."""

_LIDAR_ODOMETRY = re.compile(r"kiss|icp|lio|loam|lidar", re.IGNORECASE)
_DEPTH_CAMERA = re.compile(r"camera|depth|stereo|realsense|kinect|/zed|/oak", re.IGNORECASE)
_CAMERA_FRAME = re.compile(r"optical|depth", re.IGNORECASE)
_POSED = (*POSE_TYPES, *PATH_TYPES)
_PACKETS = ("VelodyneScan", "PacketMsg", "RobosensePacket", "RslidarScan", "HesaiScan", "PandarScan")


@dataclass(frozen=True)
class WantedTopics:
    """The user's choices for a bag; the rest is found out.

    `together` are topics whose clouds join those of `topic`. With `deskew` points that have times are moved to the
    stamp of their cloud.
    """

    topic: str | None = None
    odometry: str | None = None
    T_body_sensor: se3.Matrix4 | None = None
    together: tuple[str, ...] = ()
    deskew: bool = field(default=True, compare=False)


def choose(found: BagTopics, wanted: WantedTopics) -> Pairing:
    """The pair of topics whose frames fit best; among equals the one with most clouds that have a pose.

    Poses of another robot (`namespaces`) are no choice unless they are named. Of those that fit the same clouds alike,
    the ones that share the longer namespace with them are taken. Among equals again poses that a LiDAR odometry
    publishes go before those of wheels, told by the topic's name. A pair that has poses for less than half as many
    clouds as another one is no choice. Clouds of a depth camera, told by the names of topic and frame, are no choice
    beside others that have poses. Raises BadField, with advice, where there is none.
    """
    clouds = _named(found.clouds, wanted.topic, "topic", found)
    pairs = [pair for cloud in clouds for part in cloud.by_frame() for pair in _pairings(part, found, wanted)]
    if not pairs:
        raise BadField(_no_poses(found, clouds, wanted), field="odometry")
    counted = [(pair, int(pair.covered().sum())) for pair in pairs]
    if max(count for _, count in counted) == 0:
        raise BadField(_apart_in_time(pairs[0], found), field="poses")
    by_lidar = [(pair, count) for pair, count in counted if count and not _by_camera(pair.clouds)]
    counted = by_lidar or counted
    most = max(count for _, count in counted)
    usable = [(pair, count) for pair, count in counted if 2 * count >= most]
    return min(usable, key=lambda choice: _order(choice[0], choice[1], pairs, found))[0]


def clouds_alone(found: BagTopics, wanted: WantedTopics) -> CloudTopic:
    """The most clouds of one topic and one frame, whatever poses there are, those of a depth camera last.

    Raises BadField where there are none.
    """
    parts = [part for topic in _named(found.clouds, wanted.topic, "topic", found) for part in topic.by_frame()]
    return max(parts, key=lambda part: (not _by_camera(part), len(part.stamps)))


def with_other_frames(pair: Pairing, found: BagTopics, wanted: WantedTopics) -> list[Pairing]:
    """The pair, and those of the same topics whose clouds are in other frames that are known to lie in the same world.

    A mounting that is given is that of one sensor, and holds for the clouds of no other one.
    """
    parts = [part for part in found.clouds[pair.clouds.name].by_frame() if part.frame != pair.clouds.frame]
    if wanted.T_body_sensor is not None or pair.relation > Relation.BY_TRANSFORMS:
        return [pair]
    others = (other for part in parts for other in _pairings(part, found, wanted))
    return [pair, *(other for other in others if other.shares_poses(pair) and other.covered().any())]


def choose_beside(first: Pairing, found: BagTopics, wanted: WantedTopics) -> list[Pairing]:
    """The pairs of the topics that are wanted together with that of `first`, by the same poses.

    Raises BadField where nothing tells how their LiDARs sit on the body, or topics are named twice.
    """
    names = (first.clouds.name, *wanted.together)
    if len(set(names)) < len(names):
        raise BadField(f"topics are named twice: {', '.join(names)}", field="topic")
    if wanted.together and wanted.T_body_sensor is not None:
        raise BadField(
            "--T-body-sensor is of one sensor: LiDARs that are used together have their mountings in /tf_static",
            field="T_body_sensor",
        )
    return [_beside(first, name, found, wanted) for name in wanted.together]


def _beside(first: Pairing, topic: str, found: BagTopics, wanted: WantedTopics) -> Pairing:
    if first.poses == KISS_ICP:
        pair = _carried(first, clouds_alone(found, replace(wanted, topic=topic)), found)
    else:
        odometry = first.poses if first.poses in found.poses else wanted.odometry or TF
        pair = choose(found, replace(wanted, topic=topic, odometry=odometry))
    if pair is None or pair.relation > Relation.BY_TRANSFORMS or not pair.shares_poses(first):
        raise BadField(
            f"{topic} (frame {found.clouds[topic].frame}) and {first.clouds.name} (frame {first.clouds.frame}) cannot "
            "be used together: no static transforms tell how both sit on what the poses follow. Record /tf_static",
            field="topic",
        )
    return pair


def _carried(first: Pairing, clouds: CloudTopic, found: BagTopics) -> Pairing | None:
    """Clouds of another LiDAR, its poses those that were made for the first one; None where nothing links the two."""
    tree = found.transforms.tree(found.transforms.topics(clouds.name, None, found.clouds))
    if not tree.linked(first.clouds.frame, clouds.frame):
        return None
    why = f"the transforms tell where {clouds.frame} is in {first.clouds.frame}"
    mounting = BetweenFrames(tree, first.clouds.frame, clouds.frame)
    return Pairing(clouds, first.poses, first.relation, first.body, mounting, None, why)


def doubts(pair: Pairing, found: BagTopics, wanted: WantedTopics) -> list[str]:
    """Why the poses may be those of another robot than the one that has taken the clouds, where they are not named."""
    if wanted.odometry is not None:
        return []
    clouds, said = pair.clouds.name, []
    if rival := _closer_clouds(pair, found):
        said.append(f"{pair.poses} may be of the robot of {rival}, not of that of {clouds}: --odometry chooses")
    rivals = [topic for topic in sorted(found.poses) if _rivals(pair, topic, found)]
    if rivals:
        said.append(
            f"{', '.join(rivals)} would fit as well as {pair.poses}, and nothing tells which of them belongs to "
            f"{clouds}: if they are of several robots, --odometry chooses"
        )
    return said


def _closer_clouds(pair: Pairing, found: BagTopics) -> str:
    """A topic as that of the clouds, but in the namespace of the poses; "" where there is none."""
    clouds, common = pair.clouds.name, shared(pair.clouds.name, pair.poses)
    closer = (name for name in sorted(found.clouds) if alike(name, clouds) and shared(name, pair.poses) > common)
    return next(closer, "")


def _rivals(pair: Pairing, topic: str, found: BagTopics) -> bool:
    """Whether another topic of poses differs from that of the pair in the namespace alone, and fits as well."""
    poses = found.poses.get(pair.poses)
    if poses is None or not twins(topic, pair.poses) or _by_lidar(topic) != _by_lidar(pair.poses):
        return False
    alike = shared(topic, pair.clouds.name) == shared(pair.poses, pair.clouds.name)
    other = found.poses[topic]
    return alike and (other.frame, other.body) == (poses.frame, poses.body)


def _order(pair: Pairing, count: int, pairs: list[Pairing], found: BagTopics) -> tuple[float, ...]:
    """The smaller, the better a pair fits, and the better its poses are likely to be."""
    samples = len(found.poses[pair.poses].poses) if pair.poses in found.poses else 0
    same = [other for other in pairs if (other.clouds.name, other.relation) == (pair.clouds.name, pair.relation)]
    behind = max(other.common_segments for other in same) - pair.common_segments
    doubtful = bool(_closer_clouds(pair, found))
    return pair.relation, doubtful, behind, -count, not _by_lidar(pair.poses), -samples


def _by_camera(clouds: CloudTopic) -> bool:
    return bool(_DEPTH_CAMERA.search(clouds.name) or _CAMERA_FRAME.search(clouds.frame))


def _by_lidar(topic: str) -> bool:
    return _LIDAR_ODOMETRY.search(topic) is not None


def _named(topics: dict[str, CloudTopic], name: str | None, field: str, found: BagTopics) -> list[CloudTopic]:
    if not topics:
        raise BadField(_no_clouds(found), field="topic")
    if name is None:
        return list(topics.values())
    if name not in topics:
        raise BadField(f"no clouds on {name[:80]}; there are some on {', '.join(sorted(topics))}", field=field)
    return [topics[name]]


def _pairings(cloud: CloudTopic, found: BagTopics, wanted: WantedTopics) -> Iterator[Pairing]:
    """Candidates of poses for the clouds."""
    transforms = found.transforms
    if wanted.odometry not in (None, TF, *found.poses, *transforms.moving):
        there = ", ".join(sorted(found.poses)) or "none"
        raise BadField(f"no poses on {str(wanted.odometry)[:80]}; topics with poses: {there}", field="odometry")
    sources, others = [*found.poses, *transforms.moving], [*found.clouds, *transforms.by_topic]
    for topic in found.poses.values():
        named = wanted.odometry == topic.name
        if named or (wanted.odometry is None and not of_another_robot(cloud.name, topic.name, sources, others)):
            tree = transforms.tree(transforms.topics(cloud.name, topic.name, found.clouds))
            yield _with_odometry(cloud, topic, tree, wanted)
    topics = _topics_of_transforms(cloud, found, wanted)
    moving = [topic for topic in topics if topic in transforms.moving]
    if moving and wanted.odometry in (None, TF, *moving):
        pair = _with_transforms(cloud, ", ".join(moving), transforms.tree(topics), wanted)
        yield from [] if pair is None else [pair]


def _topics_of_transforms(cloud: CloudTopic, found: BagTopics, wanted: WantedTopics) -> tuple[str, ...]:
    """Those that tell how the clouds move: a named topic holds in any namespace."""
    named = wanted.odometry if wanted.odometry in found.transforms.moving and wanted.odometry != TF else None
    return found.transforms.topics(cloud.name, named, found.clouds)


def _with_transforms(cloud: CloudTopic, topics: str, tree: TransformTree, wanted: WantedTopics) -> Pairing | None:
    """Poses by transforms alone: of the clouds' frame, or, where its mounting is given, of the body that it sits on."""
    frame, root, given = cloud.frame, _fixed_frame(cloud.frame, tree), wanted.T_body_sensor
    body = frame if given is None else _carrier(frame, root, tree)
    root = root if root is not None or given is None or body is None else tree.parent(body)
    if root is None or body is None:
        return None
    way, why = BetweenFrames(tree, root, body), f"the transforms tell where {body} is in {root}"
    if given is None:
        return Pairing(cloud, topics, Relation.BY_TRANSFORMS, way, Fixed(np.eye(4)), None, why)
    if body == frame:
        unused = (f"--T-body-sensor is not used: the transforms lead to {frame} itself, and it sits on nothing else",)
        return Pairing(cloud, topics, Relation.BY_TRANSFORMS, way, Fixed(np.eye(4)), None, why, unused)
    why = f"{why}, and --T-body-sensor how the sensor sits on {body}"
    apart = _disagreement(cloud, BetweenFrames(tree, body, frame), given)
    return Pairing(cloud, topics, Relation.BY_TRANSFORMS, way, Fixed(given), None, why, apart)


def _carrier(frame: str, root: str | None, tree: TransformTree) -> str | None:
    """The body that a sensor sits on, itself where it moves; where no transform leads to it, the only thing that moves.

    None where several things do, or where the clouds are in a frame in which the body moves.
    """
    if root is None:
        moved = tree.moved(ODOMETRY_FRAMES)
        return moved[0] if len(moved) == 1 and frame not in tree.ancestors(moved[0]) else None
    body = tree.carrier(frame)
    return frame if body is None or root not in tree.ancestors(body) else body


def _disagreement(cloud: CloudTopic, frames: BetweenFrames, given: se3.Matrix4) -> tuple[str, ...]:
    """The warning where the transforms tell another mounting than the user."""
    if not cloud.frame or not frames.tree.linked(frames.target, frames.source):
        return ()
    known = cloud.stamps_ns[frames.covered(cloud.stamps_ns)]
    if len(known) == 0:
        return ()
    apart = se3.inverse(frames.at(int(known[0]))) @ given
    metres, degrees = float(np.linalg.norm(apart[:3, 3])), float(np.degrees(np.linalg.norm(se3.log(apart)[3:])))
    if metres < SAME_MOUNTING_M and degrees < SAME_MOUNTING_DEG:
        return ()
    if frames.source == frames.target:
        return (f"--T-body-sensor is used, though the poses follow {frames.source}, the frame of the clouds itself",)
    other = f"another mounting of {frames.source} on {frames.target}, {metres:.2f} m and {degrees:.1f} degrees from it"
    return (f"--T-body-sensor is used, though the transforms tell {other}",)


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
    warnings: tuple[str, ...] = ()
    if given is not None:
        why = "--T-body-sensor says how the sensor sits on what the poses follow"
        warnings = _disagreement(cloud, BetweenFrames(tree, topic.body, cloud.frame), given)
    elif topic.body and topic.body != cloud.frame and tree.linked(topic.body, cloud.frame):
        mounting = BetweenFrames(tree, topic.body, cloud.frame)
        why = f"the transforms tell where {cloud.frame} is in {topic.body}, which the poses follow"
    elif topic.body != cloud.frame or not topic.body:
        relation = Relation.ASSUMED
        why = (
            f"nothing tells where {cloud.frame or 'the sensor'} is in {topic.body or 'what the poses follow'}: "
            "taken as the same; else say it with --T-body-sensor"
        )
    return Pairing(cloud, topic.name, relation, poses, mounting, None, why, warnings)


def _registered(
    cloud: CloudTopic, topic: PoseTopic, poses: StampedPoses, mounting: PoseSource, tree: TransformTree
) -> Pairing:
    """Clouds that somebody has already moved into the frame of the poses, or into one above it."""
    why = f"the clouds are registered in {cloud.frame}: each is taken back to its sensor by the inverse of its pose"
    frame: PoseSource = Fixed(np.eye(4))
    if cloud.frame != topic.frame:
        frame = BetweenFrames(tree, topic.frame, cloud.frame)
    return Pairing(cloud, topic.name, Relation.REGISTERED, poses, mounting, frame, why)


def _apart_in_time(pair: Pairing, found: BagTopics) -> str:
    """The advice where no cloud of a pair was taken at a time of its poses."""
    topic = found.poses.get(pair.poses)
    posed = [] if topic is None else [topic.stamps_ns]
    said = f"no cloud of {pair.clouds.name} was taken while there were poses of {pair.poses}"
    spans = " and ".join(map(_span, (pair.clouds.stamps_ns, *(posed or pair.stamps_ns())[:1])))
    return f"{said} (stamped {spans}): are both stamped by one clock?"


def _span(stamps_ns: Stamps) -> str:
    ends = [datetime.fromtimestamp(int(at) // 10**9, UTC) for at in (stamps_ns.min(), stamps_ns.max())]
    return f"{ends[0]:%Y-%m-%d %H:%M:%S} to {ends[1]:%H:%M:%S}"


def _no_clouds(found: BagTopics) -> str:
    if empty := sorted(topic for topic, kind in found.types.items() if kind in CLOUD_TYPES):
        return f"{', '.join(empty[:5])} holds no message: did the driver publish while the bag was recorded?"
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
    if lacking := _no_mounting(cloud, found, wanted):
        return lacking
    if wanted.odometry == TF:
        return f"the transforms do not tell how {cloud.frame or 'the sensor'} moves: {_listed(found)}"
    if found.broken_poses and not found.poses:
        return (
            f"{cloud.name} (frame {cloud.frame}) has no poses: all {found.broken_poses} in the bag are no rigid "
            "motions. They hold NaN, or quaternions (x, y, z, w) that are not of length 1"
        )
    return (
        f"{cloud.name} (frame {cloud.frame}) has no poses: the bag needs a nav_msgs/Odometry, a nav_msgs/Path, a "
        f"geometry_msgs/PoseStamped, or transforms above {cloud.frame} that move. `--odometry {KISS_ICP}` makes poses "
        "of the clouds; or run a LiDAR odometry (FAST-LIO) and record what it publishes. "
        f"Topics: {_listed(found)}"
    )


def _no_mounting(cloud: CloudTopic, found: BagTopics, wanted: WantedTopics) -> str:
    """The advice where transforms move something, and none leads from there to the clouds; "" elsewhere."""
    tree = found.transforms.tree(_topics_of_transforms(cloud, found, wanted))
    moved = [body for body in tree.moved(ODOMETRY_FRAMES) if cloud.frame not in tree.ancestors(body)]
    if not moved or (wanted.T_body_sensor is not None and len(moved) == 1):
        return ""
    known = f"the transforms tell where {', '.join(f'{body} is in {tree.parent(body)}' for body in moved[:5])}"
    sensor = f"{cloud.frame or 'the sensor'} of {cloud.name}"
    if len(moved) == 1:
        return f"{known}, but not where {sensor} sits on it: say it with --T-body-sensor"
    return f"{known}, but not on which of them {sensor} sits: record /tf_static, too, or the odometry of one of them"


def _listed(found: BagTopics) -> str:
    empty = {topic for topic, kind in found.types.items() if kind in _POSED and topic not in found.poses}
    notes = dict.fromkeys(empty, ", no usable message")
    topics = [f"{topic} ({kind}{notes.get(topic, '')})" for topic, kind in sorted(found.types.items())]
    return ", ".join(topics[:20]) + (f" and {len(topics) - 20} more" if len(topics) > 20 else "")
