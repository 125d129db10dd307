"""Which topics of a bag are of one robot, as far as their names tell: topics of a robot share a namespace."""

from __future__ import annotations

from collections.abc import Collection
from itertools import takewhile


def namespace(topic: str) -> tuple[str, ...]:
    """The segments of a topic's name without the last: ("robot1", "lidar") of /robot1/lidar/points."""
    return tuple(topic.strip("/").split("/")[:-1])


def shared(first: str, second: str) -> int:
    """How many whole segments the namespaces of two topics have in common from their beginning."""
    pairs = zip(namespace(first), namespace(second), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def twins(first: str, second: str) -> bool:
    """Whether two names differ in one segment of the namespace alone, as /robot1/odom and /robot2/odom do."""
    segments, others = first.strip("/").split("/"), second.strip("/").split("/")
    differing = [one != other for one, other in zip(segments, others, strict=False)]
    return len(segments) == len(others) and sum(differing) == 1 and not differing[-1]


def alike(first: str, second: str) -> bool:
    """Whether two names are twins, or one is the other in one namespace more, as /points and /robot2/points are."""
    short, long = sorted((first.strip("/").split("/"), second.strip("/").split("/")), key=len)
    nested = len(long) == len(short) + 1 and any(long[:at] + long[at + 1 :] == short for at in range(len(short)))
    return nested or twins(first, second)


def of_another_robot(cloud: str, poses: str, sources: Collection[str], others: Collection[str]) -> bool:
    """Whether poses belong to another robot than the one that has taken the clouds.

    They do if another of the `sources` of poses is closer to the clouds, and is their twin, or one of the `others`
    (topics of clouds and of transforms) is closer to these poses than the clouds are.
    """
    common = shared(cloud, poses)
    closer = [source for source in sources if shared(cloud, source) > common]
    return bool(closer) and (
        any(twins(source, poses) for source in closer) or any(shared(other, poses) > common for other in others)
    )
