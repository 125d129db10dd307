"""Where sessions lie to each other before optimisation: by the loops that agree, strongest pair first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.consistency import ConsistentSet, oriented
from revisit.core.pose_graph.graph import PoseGraph

Array64 = NDArray[np.float64]

MIN_LOOPS = 2
"""One loop between two sessions has nothing to agree with: it joins nothing."""


@dataclass(frozen=True)
class Component:
    """Sessions that loops join, by name; T_map_odom (4, 4) of each, in the odometry frame of the first one."""

    T_map_odom: dict[str, se3.Matrix4]

    @property
    def anchor(self) -> str:
        """The session whose odometry frame is that of the component."""
        return next(iter(self.T_map_odom))

    def anchored(self, preferred: tuple[str, ...]) -> Component:
        """The same in the frame of the first session of it that `preferred` names; as it is where none is named."""
        anchor = next((session for session in preferred if session in self.T_map_odom), self.anchor)
        if anchor == self.anchor:
            return self
        T_anchor_map = se3.inverse(self.T_map_odom[anchor])
        others = {session: T_anchor_map @ T for session, T in self.T_map_odom.items() if session != anchor}
        return Component({anchor: np.eye(4), **others})


def place_sessions(graph: PoseGraph, sets: list[ConsistentSet], min_loops: int = MIN_LOOPS) -> list[Component]:
    """The connected components; a session that nothing joins is one of its own.

    A session is never put anywhere that no loop says.
    """
    links = sorted(
        (one for one in sets if len(one.loops) >= min_loops), key=lambda one: (-len(one.loops), one.sessions)
    )
    waiting = [one.session for one in graph.trajectories]
    components = []
    while waiting:
        placed = {waiting.pop(0): np.eye(4)}
        while link := next((one for one in links if len(placed.keys() & set(one.sessions)) == 1), None):
            known, new = sorted(link.sessions, key=lambda session: session not in placed)
            placed[new] = placed[known] @ _T_known_new(graph, link, known)
            waiting.remove(new)
        components.append(Component(placed))
    return components


def _T_known_new(graph: PoseGraph, link: ConsistentSet, known: str) -> se3.Matrix4:
    """Where the loops of a set put the odometry frame of the new session in that of the known one.

    The middle loop of the set in the order of the known session, where drift to both ends is least.
    """
    loops = [oriented(graph.loops[number], known) for number in link.loops]
    loop = sorted(loops, key=lambda one: (one.match, one.query))[len(loops) // 2]
    match = graph.by_session[loop.match.session].T_odom_submap[loop.match.ordinal]
    query = graph.by_session[loop.query.session].T_odom_submap[loop.query.ordinal]
    return np.asarray(match @ loop.T_match_query @ se3.inverse(query))
