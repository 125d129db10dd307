"""One loop more: the poses of a solved component, moved by the loop, by one factorisation for many loops.

The normal equations at the poses found before are factorised once, H = L L^T. A loop adds six rows J to them, and by
the identity of Woodbury (H + J^T J)^-1 follows from L^-1 J^T, which has numbers at few poses: those that come to depend
on the ends of the loop. What loops do to each other needs no more; what they do to all poses is one solution for all of
them together. Submaps that came later hang on the last one of their session by steps with covariances Q; in the
coordinates of what these steps err by, the equations have Q^-1 on their diagonal and nothing else. Steps after the
first one ask the true errors again (the chord method), so that the end is that of Gauss and Newton.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3, se3_rows
from revisit.core.pose_graph.broken_steps import BROKEN, LOOSER
from revisit.core.pose_graph.faults import composed, steps_of
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.normal_equations import Edges, Half
from revisit.core.pose_graph.optimisation import GATE, WIDE_GATE

Array64 = NDArray[np.float64]

SETTLED_M = 0.1
"""A step that moves no submap farther is the last one, metres: the rest is of second order, millimetres."""

MAX_STEPS = 5

MOST_HELD = 8
"""Loops that one factorisation carries: the farther poses have moved since, the more steps a loop takes."""

MOST_LATER = 32
"""Submaps that one factorisation carries: their poses are composed step by step."""


@dataclass(frozen=True)
class _Step:
    """A step of odometry that came after the factorisation; covariance (6, 6) in the frame of its end."""

    before: Node
    T_before_end: se3.Matrix4
    covariance: Array64


@dataclass(frozen=True)
class _Taken:
    """A loop, whitened, as the factorisation knows it.

    half: of its rows J for the poses that are factorised; later: its effect (6, 6) by the number of each later step.
    """

    loop: LoopEdge
    whitening: Array64
    half: Half
    later: dict[int, Array64]


@dataclass(frozen=True)
class _Pull:
    """A right side, half solved: half (6 n,) for the poses that are factorised, later (t, 6) for the steps after."""

    half: Array64
    later: Array64


@dataclass(frozen=True)
class _State:
    """Poses (n, 4, 4) of the submaps in the factorisation, and the error of each later step (t, 6)."""

    poses: Array64
    slips: Array64


class SolvedComponent:
    """Sessions that share a frame, as `optimise` left them, ready for further submaps and loops between them.

    `optimise` finds loops again that were set aside, and wrong ones that slipped in; this does neither.
    """

    def __init__(
        self,
        graph: PoseGraph,
        T_map_submap: Mapping[str, Array64],
        loops: Iterable[int],
        anchor: str,
    ) -> None:
        """The sessions of `T_map_submap` at these poses (n, 4, 4), and the `loops` of the graph that they rest on.

        The first submap of session `anchor` is held fast. A session may have fewer poses than its trajectory. Steps
        that the poses say are broken are as unsure as mended ones.

        The poses are taken as the most likely ones, by odometry that may be surer than it states (`odometry_weights`):
        how far a loop moves them follows from the drift as stated, as loops are judged by that.
        """
        nodes = [Node(session, ordinal) for session, poses in T_map_submap.items() for ordinal in range(len(poses))]
        self._rows = {node: row for row, node in enumerate(nodes)}
        self._ends = {session: len(poses) - 1 for session, poses in T_map_submap.items()}
        self._anchor = self._rows[Node(anchor, 0)]
        tracks = [_as_mended(graph.by_session[session], poses) for session, poses in T_map_submap.items()]
        measured = Edges.of_loops([graph.loops[number] for number in loops], self._rows)
        poses = np.concatenate(list(T_map_submap.values()))
        self._edges = Edges.of_steps(tracks, self._rows).joined(measured).as_posed(poses)
        # Tangents of the map are levers from its origin: the nearer that is, the fewer digits are lost.
        self._T_map_middle = se3.from_rotation_translation(np.eye(3), poses[:, :3, 3].mean(axis=0))
        self._state = _State(se3.inverse(self._T_map_middle) @ poses, np.zeros((0, 6)))
        self._taken: list[_Taken] = []
        self._cost = 0.0
        self._start(self._state.poses)

    def append(self, session: str, T_last_next: se3.Matrix4, covariance: Array64) -> Node:
        """A further submap of a session, a step with a covariance (6, 6) in its frame after the last one."""
        last = Node(session, self._ends[session])
        node = Node(session, last.ordinal + 1)
        self._tail[node] = len(self._steps)
        self._steps.append(_Step(last, T_last_next, covariance))
        self._state = _State(self._state.poses, np.concatenate([self._state.slips, np.zeros((1, 6))]))
        self._ends[session] = node.ordinal
        return node

    def add(self, loop: LoopEdge) -> GraphState:
        """Take the loop into the map, or set it aside where the poses, as sure as they are, contradict it.

        By how much the least cost grows is the squared Mahalanobis distance of the loop from the poses, with their
        covariance: that is held against the gate. Poses that have not settled after MAX_STEPS are judged as they are.
        """
        if len(self._taken) >= MOST_HELD or len(self._steps) > MOST_LATER:
            self.refresh()
        taken = [*self._taken, self._linearised(loop)]
        inner = self._extended_inner(taken)
        if self._expected_growth(taken, inner) > WIDE_GATE:
            return GraphState.SET_ASIDE
        state, cost = self._settled(taken, np.asarray(np.linalg.inv(inner)))
        if not cost - self._cost <= GATE:
            return GraphState.SET_ASIDE
        self._taken, self._inner, self._state, self._cost = taken, inner, state, cost
        return GraphState.IN_MAP

    def T_map_submap(self, node: Node) -> se3.Matrix4:
        """The pose (4, 4) of a submap."""
        return np.asarray(self._T_map_middle @ self._pose(node, self._state))

    def last(self, session: str) -> Node:
        """The last submap of a session."""
        return Node(session, self._ends[session])

    @property
    def carried(self) -> int:
        """The loops that the factorisation carries beside its own."""
        return len(self._taken)

    @property
    def is_half_full(self) -> bool:
        """Whether the factorisation carries half of its limit: time for a new one, where there is time."""
        return 2 * len(self._taken) >= MOST_HELD or 2 * len(self._steps) >= MOST_LATER

    def refresh(self) -> None:
        """Factorise anew, with the new submaps and loops, and settle the rest.

        For when there is time; `add` does it where it must.
        """
        tail = list(self._tail)
        later = np.array([self._pose(node, self._state) for node in tail]).reshape(-1, 4, 4)
        for node in tail:
            self._rows[node] = len(self._rows)
        steps = Edges.of_motions(
            [(self._rows[step.before], self._rows[node]) for step, node in zip(self._steps, tail, strict=True)],
            [step.T_before_end for step in self._steps],
            [step.covariance for step in self._steps],
        )
        loops = Edges.of_loops([one.loop for one in self._taken], self._rows)
        self._edges = self._edges.joined(steps).joined(loops)
        del self._factors  # the next ones take as much room
        self._start(np.concatenate([self._state.poses, later]))
        gradient = self._edges.cost_and_gradient(self._state.poses)[1]
        self._state, _ = self._moved(self._state, -self._factors.solve(gradient))
        self._cost = self._edges.cost_and_gradient(self._state.poses)[0]

    def _start(self, poses: Array64) -> None:
        self._state = _State(poses, np.zeros((0, 6)))
        self._tail: dict[Node, int] = {}
        self._steps: list[_Step] = []
        self._taken, self._inner = [], np.zeros((0, 0))
        self._factors = self._edges.in_the_map(poses).factorised(self._anchor)
        self._cost = self._edges.cost_and_gradient(poses)[0]

    def _linearised(self, loop: LoopEdge) -> _Taken:
        information = np.linalg.inv(loop.covariance_in_query / loop.independent_share)
        whitening = np.linalg.cholesky(information).T
        rows, known = self._loop_rows(loop, whitening, self._state), len(self._state.poses)
        half = self._factors.half_at({number: block.T for number, block in rows.items() if number < known})
        later = {number - known: block for number, block in rows.items() if number >= known}
        return _Taken(loop, whitening, half, later)

    def _extended_inner(self, taken: list[_Taken]) -> Array64:
        """I + J H^-1 J^T (6 l, 6 l) of some loops, all but the last of which are in the map."""
        across = np.hstack([self._product(taken[-1], one) for one in taken])
        inner = np.eye(6 * len(taken))
        inner[:-6, :-6] = self._inner
        inner[-6:] += across
        inner[:-6, -6:] = across[:, :-6].T
        return inner

    def _product(self, one: _Taken, other: _Taken) -> Array64:
        """The effect (6, 6) of the pull of one loop on another."""
        product = one.half.product(other.half)
        for number in one.later.keys() & other.later.keys():
            product += one.later[number] @ self._steps[number].covariance @ other.later[number].T
        return product

    def _expected_growth(self, taken: list[_Taken], inner: Array64) -> float:
        """The squared distance of the last loop from poses with their covariance, to first order."""
        error = self._error(taken[-1], self._state)
        before = inner[:-6, :-6]
        own = inner[-6:, -6:] - inner[-6:, :-6] @ np.linalg.solve(before, inner[:-6, -6:])
        return float(error @ np.linalg.solve(own, error))

    def _settled(self, taken: list[_Taken], inverted: Array64) -> tuple[_State, float]:
        """The poses with all `taken` loops, and their cost."""
        state, cost = self._state, np.inf
        pull = _Pull(np.zeros(6 * len(state.poses)), np.zeros_like(state.slips))
        _add(taken[-1], pull, self._error(taken[-1], state))
        for _ in range(MAX_STEPS):
            state, moved_m = self._moved(state, -self._step(pull, taken, inverted))
            cost, gradient = self._cost_and_gradient(taken, state)
            if moved_m < SETTLED_M:
                break
            known = len(state.poses)
            pull = _Pull(self._factors.half(gradient[:known]), gradient[known:])
        return state, cost

    def _step(self, pull: _Pull, taken: list[_Taken], inverted: Array64) -> Array64:
        """The step (u, 6) by a pull, which is used up, with all `taken` loops (Woodbury)."""
        covariances = np.reshape([step.covariance for step in self._steps], (-1, 6, 6))
        back = inverted @ np.concatenate([
            one.half.times(pull.half) + sum(block @ covariances[n] @ pull.later[n] for n, block in one.later.items())
            for one in taken
        ])  # fmt: skip
        for one, amounts in zip(taken, back.reshape(-1, 6), strict=True):
            _add(one, pull, -amounts)
        later = np.einsum("tij,tj->ti", covariances, pull.later)
        return np.concatenate([self._factors.whole(pull.half), later])

    def _moved(self, state: _State, step: Array64) -> tuple[_State, float]:
        """The state after a step (u, 6), and how far the farthest submap moves, metres."""
        known = len(state.poses)
        poses = se3_rows.exp(step[:known]) @ state.poses
        moved = np.abs(poses[:, :3, 3] - state.poses[:, :3, 3]).max()
        return _State(poses, state.slips + step[known:]), float(moved)

    def _cost_and_gradient(self, taken: list[_Taken], state: _State) -> tuple[float, Array64]:
        """Squared errors of everything, and half their gradient (u, 6)."""
        cost, of_poses = self._edges.cost_and_gradient(state.poses)
        weighed = [np.linalg.solve(step.covariance, slip) for step, slip in zip(self._steps, state.slips, strict=True)]
        cost += sum(float(slip @ weight) for slip, weight in zip(state.slips, weighed, strict=True))
        gradient = np.concatenate([of_poses, np.reshape(weighed, (-1, 6))])
        for one in taken:
            error = self._error(one, state)
            cost += float(error @ error)
            for number, block in self._loop_rows(one.loop, one.whitening, state).items():
                gradient[number] += block.T @ error
        return cost, gradient

    def _error(self, one: _Taken, state: _State) -> Array64:
        """The whitened error (6,) of a loop."""
        match, query = self._pose(one.loop.match, state), self._pose(one.loop.query, state)
        return np.asarray(one.whitening @ se3.log(se3.inverse(match @ one.loop.T_match_query) @ query))

    def _loop_rows(self, loop: LoopEdge, whitening: Array64, state: _State) -> dict[int, Array64]:
        """The effect on a loop (6, 6), by the number of the unknown: of poses first, then of steps."""
        T_query_map = se3.inverse(self._pose(loop.query, state))
        rows: dict[int, Array64] = {}
        for node, sign in ((loop.match, -1.0), (loop.query, 1.0)):
            for number, T_map_moved in self._movers(node, state):
                block = sign * whitening @ se3.adjoint(T_query_map @ T_map_moved)
                rows[number] = rows[number] + block if number in rows else block
        return rows

    def _pose(self, node: Node, state: _State) -> se3.Matrix4:
        """Of a submap, in the middle of the map."""
        behind = np.eye(4)
        while node in self._tail:
            number = self._tail[node]
            step = self._steps[number]
            behind = step.T_before_end @ se3.exp(state.slips[number]) @ behind
            node = step.before
        return np.asarray(state.poses[self._rows[node]] @ behind)

    def _movers(self, node: Node, state: _State) -> list[tuple[int, se3.Matrix4]]:
        """The unknowns that a pose hangs on, and the pose of the frame that each of them is in."""
        movers = []
        while node in self._tail:
            number = self._tail[node]
            movers.append((len(state.poses) + number, self._pose(node, state)))
            node = self._steps[number].before
        return [*movers, (self._rows[node], np.eye(4))]


def _as_mended(track: Trajectory, poses: Array64) -> Trajectory:
    """The session with the steps of `poses` (n, 4, 4) instead of those that these say are broken."""
    known = len(poses)
    seen, stated = se3_rows.inverse(poses[:-1]) @ poses[1:], steps_of(track)[: known - 1]
    covariances = track.step_covariances.copy()
    apart = se3_rows.log(se3_rows.inverse(stated) @ seen)
    weighed = np.linalg.solve(covariances[: known - 1], apart[..., None])[..., 0]
    broken = np.einsum("ni,ni->n", apart, weighed) > BROKEN
    if not broken.any():
        return track
    motions = steps_of(track)
    motions[: known - 1][broken] = seen[broken]
    covariances[: known - 1][broken] *= LOOSER
    return replace(track, T_odom_submap=composed(track.T_odom_submap[0], motions), step_covariances=covariances)


def _add(one: _Taken, pull: _Pull, amounts: Array64) -> None:
    """Add the pull J^T `amounts` (6,) of a loop."""
    one.half.add_to(pull.half, amounts)
    for number, block in one.later.items():
        pull.later[number] += block.T @ amounts
