"""Whether the clock behind a topic was set back while a bag was recorded."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from revisit.core.sanity.finding import LIKELY_CAUSES, Finding
from revisit.evaluation.datasets.bag_topics import BagTopics
from revisit.evaluation.datasets.pairing import Pairing
from revisit.evaluation.datasets.posed_clouds import Stamps

FOLLOWING = 3
"""A clock was set back if so many messages in a row are earlier than one before them: fewer come out of order."""


@dataclass(frozen=True)
class SetBack:
    """The first time that the stamps of `topic` go back, behind so many messages, and how often they do."""

    topic: str
    message: int
    before_ns: int
    after_ns: int
    times: int = 1

    def __str__(self) -> str:
        often = "" if self.times == 1 else f", and {self.times - 1} times more"
        return (
            f"the stamps of {self.topic} go back by {(self.before_ns - self.after_ns) / 1e9:.3f} s "
            f"from {self.before_ns / 1e9:.3f} s, behind {self.message} messages{often}"
        )


def set_back(topic: str, stamps_ns: Stamps) -> SetBack | None:
    """Where stamps (n,) in the order of the bag go back for good, or for several messages in a row."""
    latest = np.maximum.accumulate(stamps_ns)
    late = np.concatenate([[False], stamps_ns < latest, [False]])
    starts, ends = np.flatnonzero(~late[:-1] & late[1:]), np.flatnonzero(late[:-1] & ~late[1:])
    long = starts[ends - starts >= FOLLOWING]
    if len(long) == 0:
        return None
    first = int(long[0])
    return SetBack(topic, first, int(latest[first - 1]), int(stamps_ns[first]), len(long))


def check_clocks(pairs: Iterable[Pairing], found: BagTopics) -> list[Finding]:
    """Whether stamps of the topics in use go back in the order of the bag."""
    back: dict[str, SetBack] = {}
    for pair in pairs:
        streams = [
            (pair.clouds.name, pair.clouds.stamps_ns),
            *(("the transforms", stamps) for stamps in pair.stamps_ns()),
        ]
        if pair.poses in found.poses:
            streams.append((pair.poses, found.poses[pair.poses].stamps_ns))
        for topic, stamps_ns in streams:
            if one := set_back(topic, stamps_ns):
                back.setdefault(topic, one)
    if not back:
        return []
    measured = "; ".join(str(one) for one in back.values())
    cause, _ = LIKELY_CAUSES["time_goes_back"]
    advice = "cut the bag where its times go back: at times that come twice, poses of both runs are mixed"
    return [Finding("time_goes_back", measured, cause, advice)]
