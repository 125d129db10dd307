"""What is said about a bag that was read: sentences for people, warnings among them."""

from __future__ import annotations

from revisit.evaluation.datasets.bag_topics import BagTopics
from revisit.evaluation.datasets.pairing import Pairing, Relation
from revisit.evaluation.datasets.posed_clouds import Stamps
from revisit.evaluation.datasets.topic_choice import WantedTopics, doubts


def notes(pair: Pairing, found: BagTopics, wanted: WantedTopics, stamps: Stamps, files: int) -> tuple[str, ...]:
    """What was taken, why, what else there was, and what is wrong. `stamps` (n,) are those of the scans, rising."""
    said = [*_taken(pair, found, stamps), *_left(pair, found)]
    if files > 1:
        said.append(f"{files} files read as one recording")
    warnings = [*pair.warnings, *doubts(pair, found, wanted), *_gaps(pair, stamps), *_lost(found)]
    return (*said, *(f"warning: {warning}" for warning in warnings))


def _taken(pair: Pairing, found: BagTopics, stamps: Stamps) -> list[str]:
    clouds = pair.clouds
    said = [
        f"clouds of {clouds.name} (frame {clouds.frame or 'not named'}), {len(stamps)} of {len(clouds.stamps)} with a pose"
    ]
    if pair.poses in found.poses:
        topic = found.poses[pair.poses]
        said.append(f"poses of {pair.poses} (frame {topic.frame}, following {topic.body or 'what it does not name'})")
    else:
        said.append(f"poses by the transforms of {pair.poses}")
    return [*said, ("warning: " if pair.relation is Relation.ASSUMED else "") + pair.why]


def _left(pair: Pairing, found: BagTopics) -> list[str]:
    clouds, poses = sorted(found.clouds.keys() - {pair.clouds.name}), sorted(found.poses.keys() - {pair.poses})
    said = [
        f"not used: {', '.join(names)}; {option} chooses"
        for option, names in (("--topic", clouds), ("--odometry", poses)) if names
    ]  # fmt: skip
    held = found.transforms.topics(pair.clouds.name, pair.poses, found.clouds)
    if strange := sorted(found.transforms.told.keys() - set(held)):
        said.append(f"not used: transforms of {', '.join(strange)}, which are in the namespace of other topics")
    return said


def _gaps(pair: Pairing, stamps: Stamps) -> list[str]:
    told = pair.clouds.stamps_ns
    missing = int(((told >= stamps[0]) & (told <= stamps[-1])).sum()) - len(stamps)
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
