"""The transforms of a bag by their topics: robots of a fleet have frames of the same names, each in a namespace."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field

from revisit.evaluation.datasets.namespaces import namespace, twins
from revisit.evaluation.datasets.ros_messages import StampedTransform
from revisit.evaluation.datasets.transform_tree import TransformTree


@dataclass
class TransformGroups:
    """The transforms of each topic, in the order of the bag.

    Transforms of /robot1/tf and /robot1/tf_static hold for topics in the namespace /robot1; those of /tf and /tf_static
    hold for all topics.
    """

    by_topic: dict[str, list[StampedTransform]] = field(default_factory=dict)
    _trees: dict[tuple[str, ...], TransformTree] = field(default_factory=dict, repr=False)

    def take(self, topic: str, transforms: Iterable[StampedTransform]) -> None:
        """Add the transforms of a message."""
        self.by_topic.setdefault(topic, []).extend(transforms)

    @property
    def moving(self) -> list[str]:
        """The topics that tell transforms that move, in alphabetical order."""
        return sorted(topic for topic in self.by_topic if not _is_static(topic))

    def topics(self, cloud: str, poses: str | None, clouds: Collection[str]) -> tuple[str, ...]:
        """The topics whose transforms hold for clouds and their poses, those of the longest namespaces first.

        A single namespace of transforms holds for clouds outside of it, too, unless there are such clouds within it.
        """
        names = [cloud] if poses is None else [cloud, poses]
        held = {topic for topic in self.by_topic if any(_within(name, topic) for name in names)}
        named = {namespace(topic) for topic in self.by_topic} - {()}
        moves_at_root = any(not namespace(topic) for topic in self.moving)
        if len(named) == 1 and not moves_at_root:
            held |= {topic for topic in self.by_topic if not any(twins(cloud, c) and _within(c, topic) for c in clouds)}
        return tuple(sorted(held, key=lambda topic: (-len(namespace(topic)), topic)))

    def tree(self, topics: tuple[str, ...]) -> TransformTree:
        """The tree that some topics tell; what a longer namespace tells of a frame goes before a shorter one."""
        if topics not in self._trees:
            self._trees[topics] = TransformTree(
                self._of(topic for topic in topics if not _is_static(topic)),
                self._of(topic for topic in topics if _is_static(topic)),
            )
        return self._trees[topics]

    def _of(self, topics: Iterable[str]) -> Iterator[StampedTransform]:
        owner: dict[str, tuple[str, ...]] = {}
        for topic in topics:
            for transform in self.by_topic[topic]:
                if owner.setdefault(transform.child, namespace(topic)) == namespace(topic):
                    yield transform


def _is_static(topic: str) -> bool:
    return topic.endswith("tf_static")


def _within(topic: str, transforms: str) -> bool:
    """Whether a topic lies in the namespace of a topic of transforms."""
    outer = namespace(transforms)
    return namespace(topic)[: len(outer)] == outer
