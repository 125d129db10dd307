"""A solved map of `core.pose_graph` behind its port: one component a frame, made when a loop first asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, loop_covariance
from revisit.core.pose_graph.independence import share_beside
from revisit.core.pose_graph.variance_factor import rescaled, variance_factor
from revisit.core.pose_graph.warm_start import SolvedComponent
from revisit.service.ports.map_optimiser import MapGraph, SolvedTrack, TrackLoop

Array64 = NDArray[np.float64]


class CoreSolvedMap:
    """`SolvedMap` by `core.pose_graph.warm_start`."""

    def __init__(self, graph: MapGraph, posed: PoseGraph, names: dict[int, str], tracks: Sequence[SolvedTrack]) -> None:
        """A map, the same as `posed` by the `names` of its tracks, and poses of its tracks."""
        self._factor = variance_factor(posed)
        self._posed = rescaled(posed, self._factor)
        self._window_m = graph.window_m
        self._tracks = {names[track.session_number]: track for track in tracks}
        self._names = {track.session_number: names[track.session_number] for track in tracks}
        self._models = {names[track.session_number]: track.odometry for track in graph.tracks}
        self._nodes = {
            number: Node(self._names[track.session_number], place)
            for track in graph.tracks
            for place, number in enumerate(track.submaps)
        }
        self._odometry = {one.session: list(one.T_odom_submap) for one in self._posed.trajectories}
        self._components: dict[int, SolvedComponent] = {}
        self._beside: dict[tuple[str, str], list[Array64]] = {}
        for loop in self._posed.loops:
            self._remember(loop.match, loop.query)

    def append(self, session_number: int, submap: int, T_odom_submap: se3.Matrix4) -> None:
        """See `SolvedMap`."""
        if (name := self._names.get(session_number)) is None:
            return
        self._odometry[name].append(np.asarray(T_odom_submap))
        self._nodes[submap] = Node(name, len(self._odometry[name]) - 1)
        if (component := self._components.get(self._tracks[name].anchor)) is not None:
            self._append(component, self._nodes[submap])

    def add(self, loop: TrackLoop) -> bool:
        """See `SolvedMap`."""
        match, query = self._nodes.get(loop.match), self._nodes.get(loop.query)
        if match is None or query is None:
            return False
        anchor = self._tracks[match.session].anchor
        if anchor != self._tracks[query.session].anchor:
            return False
        covariance = self._factor * loop_covariance(loop.covariance)
        edge = LoopEdge(str(loop.number), match, query, loop.T_match_query, covariance)
        taken = self._component(anchor).add(replace(edge, independent_share=self._share(match, query)))
        if taken is not GraphState.IN_MAP:
            return False
        self._remember(match, query)
        return True

    def corrections(self) -> dict[int, se3.Matrix4]:
        """See `SolvedMap`."""
        found = {}
        for number, name in self._names.items():
            component = self._components.get(self._tracks[name].anchor)
            if component is not None:
                T_map_last = component.T_map_submap(component.last(name))
                found[number] = np.asarray(T_map_last @ se3.inverse(self._odometry[name][-1]))
        return found

    def refresh(self) -> None:
        """See `SolvedMap`."""
        for component in self._components.values():
            if component.is_half_full:
                component.refresh()

    def _component(self, anchor: int) -> SolvedComponent:
        if anchor not in self._components:
            poses = {name: track.T_map_submap for name, track in self._tracks.items() if track.anchor == anchor}
            loops = [
                n
                for n, loop in enumerate(self._posed.loops)
                if {loop.match.session, loop.query.session} <= poses.keys()
            ]
            held = self._names.get(anchor, min(poses))
            made = self._components[anchor] = SolvedComponent(self._posed, poses, loops, held)
            for name, known in poses.items():
                for ordinal in range(len(known), len(self._odometry[name])):
                    self._append(made, Node(name, ordinal))
        return self._components[anchor]

    def _append(self, component: SolvedComponent, node: Node) -> None:
        poses = self._odometry[node.session]
        T_step = se3.inverse(poses[node.ordinal - 1]) @ poses[node.ordinal]
        covariance = self._models[node.session].covariances(np.linalg.norm(T_step[None, :3, 3], axis=1))[0]
        component.append(node.session, T_step, self._factor * covariance)

    def _share(self, match: Node, query: Node) -> float:
        others = self._beside.get((match.session, query.session), [])
        return share_beside(self._ends_m(match, query), np.reshape(others, (-1, 2, 3)), self._window_m)

    def _remember(self, match: Node, query: Node) -> None:
        self._beside.setdefault((match.session, query.session), []).append(self._ends_m(match, query))

    def _ends_m(self, match: Node, query: Node) -> Array64:
        """The positions (2, 3) of the ends of a loop in their odometry frames, metres."""
        return np.stack([self._odometry[node.session][node.ordinal][:3, 3] for node in (match, query)])
