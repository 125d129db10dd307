"""Notes on a bag that was read: sentences for people, warnings among them."""

from __future__ import annotations

import numpy as np

from revisit.core.errors import RevisitError
from revisit.evaluation.datasets.bag_message import Bag
from revisit.evaluation.datasets.bag_topics import BagTopics
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP
from revisit.evaluation.datasets.pairing import Pairing, Relation
from revisit.evaluation.datasets.placed_clouds import Merged, PlacedClouds
from revisit.evaluation.datasets.posed_clouds import Stamps
from revisit.evaluation.datasets.topic_choice import WantedTopics, doubts


def notes(pairs: list[Pairing], found: BagTopics, wanted: WantedTopics, stamps: Stamps, files: int) -> tuple[str, ...]:
    """The choice of topics, its reason, the others, and faults.

    The pairs differ in the frame of their clouds alone. `stamps` (n,) are those of the scans, rising.
    """
    first = pairs[0]
    said = [*_taken(pairs, found, stamps), *_left(first, found, wanted)]
    if files > 1:
        said.append(f"{files} files read as one recording")
    warnings = [*first.warnings, *doubts(first, found, wanted), *_other_frames(pairs, found), *_gaps(pairs, stamps)]
    return (*said, *(f"warning: {warning}" for warning in (*warnings, *_lost(found))))


def notes_of_merged(others: list[list[Pairing]], together: Merged, found: BagTopics) -> tuple[str, ...]:
    """The clouds of other LiDARs in the scans, and how many of them are in none."""
    said, warnings = [], []
    scans = len(together.scans.stamps_ns)
    for pairs, taken, offered in zip(others, together.taken, together.offered, strict=True):
        topic, frames = pairs[0].clouds.name, ", ".join(pair.clouds.frame for pair in pairs)
        said.append(f"clouds of {topic} (frame {frames}) are in {taken} of {scans} scans: {pairs[0].why}")
        left = len(found.clouds[topic].stamps) - taken
        if left:
            warnings.append(
                f"warning: {left} clouds of {topic} were left out: {left - offered + taken} have no pose or no known "
                f"mounting, {offered - taken} are more than {_ms(together.reach_ns)} from a scan, or another is nearer"
            )
    if others:
        said.append(f"clouds of one scan are at most {_ms(together.apart_ns)} apart, and moved by the poses between")
    return (*said, *warnings)


def notes_of_deskewing(bag: Bag, scans: PlacedClouds) -> list[str]:
    """Whether the clouds are deskewed, as the first one tells; nothing where that cannot be."""
    first = scans.clouds[0][0]
    try:
        sweep = first.sweep(bag)
    except RevisitError:
        return []
    return [] if sweep is None else ["points have times: each is moved to the stamp of its cloud; else --no-deskew"]


def _ms(time_ns: int) -> str:
    return f"{time_ns / 1e6:.0f} ms"


def _taken(pairs: list[Pairing], found: BagTopics, stamps: Stamps) -> list[str]:
    first, taken = pairs[0], sum(len(pair.clouds.stamps) for pair in pairs)
    frames = f"frame{'s' * (len(pairs) > 1)} {', '.join(pair.clouds.frame or 'not named' for pair in pairs)}"
    said = [f"clouds of {first.clouds.name} ({frames}), {len(stamps)} of {taken} with a pose"]
    if first.poses in found.poses:
        topic = found.poses[first.poses]
        said.append(f"poses of {first.poses} (frame {topic.frame}, following {topic.body or 'no frame that it names'})")
    elif first.poses != KISS_ICP:
        said.append(f"poses by the transforms of {first.poses}")
    return [*said, *(("warning: " if pair.relation is Relation.ASSUMED else "") + pair.why for pair in pairs)]


def _other_frames(pairs: list[Pairing], found: BagTopics) -> list[str]:
    """How many clouds of the topic are in frames that are not known to lie in what the poses follow."""
    topic, known = found.clouds[pairs[0].clouds.name], [pair.clouds.frame for pair in pairs]
    return [
        f"{len(part.stamps)} of {len(topic.stamps)} clouds of {topic.name} are in another frame, "
        f"{part.frame or 'which they do not name'}, and were left out: nothing tells how it lies to {known[0]}"
        for part in topic.by_frame() if part.frame not in known
    ]  # fmt: skip


def _left(pair: Pairing, found: BagTopics, wanted: WantedTopics) -> list[str]:
    clouds = sorted(found.clouds.keys() - {pair.clouds.name, *wanted.together})
    poses = sorted(found.poses.keys() - {pair.poses})
    said = [
        f"not used: {', '.join(names)}; {option} chooses"
        for option, names in (("--topic", clouds), ("--odometry", poses)) if names
    ]  # fmt: skip
    held = found.transforms.topics(pair.clouds.name, pair.poses, found.clouds)
    if strange := sorted(found.transforms.by_topic.keys() - set(held)):
        said.append(f"not used: transforms of {', '.join(strange)}, which are in the namespace of other topics")
    return said


def _gaps(pairs: list[Pairing], stamps: Stamps) -> list[str]:
    stamped = np.concatenate([pair.clouds.stamps_ns for pair in pairs])
    missing = int(((stamped >= stamps[0]) & (stamped <= stamps[-1])).sum()) - len(stamps)
    return (
        [f"{missing} clouds lie in gaps of the poses, in which the robot moved, and were left out"] if missing else []
    )


def _lost(found: BagTopics) -> list[str]:
    said = []
    if found.broken_poses:
        said.append(f"{found.broken_poses} messages with poses that are no rigid motions were left out")
    if found.unreadable:
        said.append(f"{found.unreadable} messages cannot be read and were left out")
    if found.damaged:
        said.append(f"{found.damaged} chunks are damaged, and what was in them is left out")
    if found.cut:
        said.append(f"{found.cut} ends within a record, as after a loss of power: read as far as it goes")
    return said
