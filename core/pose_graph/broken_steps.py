"""Steps of odometry that are wrong by far more than they state: a wheel that slips, an estimate that jumps or turns.

One such step bends a map: the loops on one side of it agree with each other, those on the other side do so too, and
both together with the odometry only at the price of half of them. Graduated non-convexity over steps and loops alike
finds the steps without which everything else agrees. A place that is taken for another one looks like that too, so a
step is broken only where loops of several places speak for it on both sides, by no more than odometry goes wrong, and
where the way beyond is not back where odometry has it; undecided where they are of one place on a side, or say a large
turn (docs/decisions/0095).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3, se3_rows
from revisit.core.pose_graph.faults import LEAST_LOOPS, FaultKind, Mending, OdometryFault, steps_of
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.least_squares import graduated, minimise
from revisit.core.pose_graph.normal_equations import Edges
from revisit.core.pose_graph.support import STRETCH, joined_stretches, votes
from revisit.core.pose_graph.unconfirmed import Kept

Array64 = NDArray[np.float64]

BROKEN = 40.0
"""Squared Mahalanobis distance of a step that is broken: chi-square with 6 degrees of freedom, one in two millions."""

BENT = 75.0
"""Squared distances of IN_A_ROW steps together, which share out a broken one where no loop is: chi-square with 30
degrees of freedom, one in a hundred thousand.
"""

BENT_BETWEEN = 30.0
"""Squared distances of all steps between two loops together: chi-square with 6 degrees of freedom, one in 25,000."""

APART = 3
"""Submaps by which broken steps may be apart to be one fault: noise shifts a part of it to its neighbours."""

LEAST_PLACES = 2
"""On each side of a fault: the places that loops show which hold."""

MOST_M, MOST_RAD = 15.0, float(np.radians(45.0))
"""A larger shift is more likely another place than a fault of odometry; so may a larger turn be, which is undecided."""

EXPLAINED = 0.8
"""The share of the places that loops show which must hold once the steps are mended."""

SMALL_SHARE = 0.3
"""Of a fault: what is less beside it is none, and what two faults leave together that come back."""

LEAST_RAD = float(np.radians(2.0))
"""A fault that turns by less is no turn."""

LEVER_M = 20.0
"""Metres by which a turn is as large as a shift."""

UNLIKE_SHARE, UNLIKE_RAD = 0.2, float(np.radians(3.0))
"""Of the way of a step, and its turn: from which on it is unlike another."""

NEAR_STEPS = 4
"""Steps before and behind, all of which an odd one is unlike."""

LOOSER = 10.0
"""How many times the variance of a step is once it is mended."""

_LOOSE = 1e-6
"""The weight of a step that is broken, while the others say how far."""


class Steps(Enum):
    """The steps that are asked whether they are broken.

    Which of two sessions goes wrong, and where between two loops, no loop tells, but the step that is unlike those near
    it is rather the one: ODD ones are asked first. Where no loop is for a while the others share a fault among them, so
    that none of them all looks broken: therefore ODD_UNHEARD ones, of which but one may be broken. Then ALL.
    """

    ODD = auto()
    ODD_UNHEARD = auto()
    ALL = auto()


def broken_steps(search: StepSearch, steps: Steps) -> list[Mending]:
    """The broken ones among some steps of sessions that share a frame. Undecided are those that loops of one place
    show on a side, and large turns: of a short drive, or of a place that is taken for another one.
    """
    held = search.held(steps) if search.most_explained >= EXPLAINED else None
    if held is None or not held.broken.any() or held.explained < EXPLAINED:
        return []
    events = [one for track in held.tracks for one in _events(held, track)]
    if steps is Steps.ODD_UNHEARD:
        most = max((one.size for one in events), default=0.0)
        events = [one for one in events if one.size >= SMALL_SHARE * most]
        if len(events) != 1:
            return []
    possible = np.array([_is_possible(one, events) for one in events], dtype=bool)
    certain = possible & np.array([one.is_certain for one in events], dtype=bool)
    sizes = np.array([one.size for one in events])
    outweighs, stands = (SMALL_SHARE * sizes > sizes[~some].max(initial=0.0) for some in (possible, certain))
    is_sure, is_large = certain & stands, sizes >= SMALL_SHARE * sizes.max(initial=0.0)
    return [
        one.mending if sure else one.mending.undecided()
        for one, chosen, sure in zip(events, possible & outweighs & (is_sure | is_large), is_sure, strict=True)
        if chosen
    ]


def shows_a_fault(loop: LoopEdge, T_map_submap: dict[str, Array64]) -> bool:
    """Whether a loop lies so near to the poses (n, 4, 4) of its sessions that a fault of odometry explains the rest."""
    T_map_match = T_map_submap[loop.match.session][loop.match.ordinal]
    T_map_query = T_map_submap[loop.query.session][loop.query.ordinal]
    tangent = se3.log(se3.inverse(T_map_match @ loop.T_match_query) @ T_map_query)
    turn, lever_m = float(np.linalg.norm(tangent[3:])), float(np.ptp(T_map_submap[loop.query.session][:, :3, 3]))
    return float(np.linalg.norm(tangent[:3])) < MOST_M + turn * lever_m


def is_bent(graph: PoseGraph, kept: Collection[int], T_map_submap: dict[str, Array64]) -> bool:
    """Whether poses (n, 4, 4) of sessions bend steps in a row, or those between submaps at which `kept` loops end, as
    only a broken one does: loops need not be lost.
    """
    tracks = [one for one in graph.trajectories if one.session in T_map_submap]
    rows = {Node(one.session, k): n for n, (one, k) in enumerate((one, k) for one in tracks for k in range(len(one)))}
    steps = Edges.of_steps(tracks, rows)
    if not len(steps):
        return False
    loops = Edges.of_loops([graph.loops[n] for n in sorted(kept)], rows)
    in_a_row, between = Kept(steps, loops, np.concatenate([T_map_submap[one.session] for one in tracks])).bends()
    return bool((in_a_row > BENT).any() or (between > BENT_BETWEEN).any())


@dataclass(frozen=True)
class StepSearch:
    """A search for broken steps: sessions with the poses (n, 4, 4) to begin with, their steps, and loops with their
    votes (l,), of which some cannot hold whatever is broken.
    """

    tracks: tuple[Trajectory, ...]
    start: Array64
    steps: Edges
    loops: tuple[LoopEdge, ...]
    edges: Edges
    votes: Array64
    may_hold: NDArray[np.bool_]

    @classmethod
    def of(
        cls, graph: PoseGraph, kept: Collection[int], left: Collection[int], T_map_submap: dict[str, Array64]
    ) -> StepSearch:
        """By sessions that share a frame, with poses (n, 4, 4) of each.

        Of loops within these sessions, by number, `kept` are those in the map, and `left` others that may be right:
        with loops beside them that agree.
        """
        tracks = tuple(one for one in graph.trajectories if one.session in T_map_submap)
        nodes = [Node(one.session, ordinal) for one in tracks for ordinal in range(len(one))]
        rows = {node: row for row, node in enumerate(nodes)}
        numbers = sorted({*kept, *left})
        loops = tuple(graph.loops[number] for number in numbers)
        steps, edges = Edges.of_steps(tracks, rows), Edges.of_loops(loops, rows)
        start, in_map = np.concatenate([T_map_submap[one.session] for one in tracks]), np.isin(numbers, list(kept))
        map_so_far = Kept(steps, edges.chosen(in_map), start)
        may_hold = in_map | map_so_far.may_hold(edges)
        return cls(tracks, start, steps, loops, edges, votes(joined_stretches(loops)), may_hold)

    @property
    def most_explained(self) -> float:
        """The share of all places, at most, that can hold."""
        return float(np.average(self.may_hold, weights=self.votes))

    def held(self, asked: Steps) -> _Held:
        """What holds by graduated non-convexity over the steps asked about and the loops that may hold.

        Unheard, these steps say nothing while it goes on.
        """
        free = np.concatenate([_odd(one) | (asked is Steps.ALL) for one in self.tracks])
        chosen = np.flatnonzero(self.may_hold)
        edges = self.steps.joined(self.edges.chosen(chosen))
        known = np.concatenate([~free, np.zeros(len(chosen), bool)])
        if asked is Steps.ODD_UNHEARD:
            heard = edges.weighted(np.concatenate([np.where(free, _LOOSE, 1.0), np.ones(len(chosen))]))
            poses = graduated(heard, len(self.steps), 0, self.start)
        else:
            poses = graduated(edges.chosen(np.argsort(~known, kind="stable")), int(known.sum()), 0, self.start)
        holds = known | (edges.squared_errors(poses) < BROKEN)
        poses = minimise(edges.weighted(np.where(holds, 1.0, _LOOSE)), 0, poses)
        holds = known | (edges.squared_errors(poses) < BROKEN)
        right = chosen[holds[len(self.steps) :]]
        by_session = np.split(poses, np.cumsum([len(one) for one in self.tracks])[:-1])
        named = {one.session: its for one, its in zip(self.tracks, by_session, strict=True)}
        explained = float(self.votes[right].sum() / self.votes.sum())
        return _Held(self.tracks, named, ~holds[: len(self.steps)], tuple(self.loops[n] for n in right), explained)


@dataclass(frozen=True)
class _Held:
    """Result of a search: poses by session, broken steps, loops that hold, and the share of places that these show."""

    tracks: tuple[Trajectory, ...]
    poses: dict[str, Array64]
    broken: NDArray[np.bool_]
    loops: tuple[LoopEdge, ...]
    explained: float

    def broken_of(self, track: Trajectory) -> NDArray[np.int64]:
        """The broken steps of a session, by the submap that they begin at."""
        before = sum(len(one) - 1 for one in self.tracks[: self.tracks.index(track)])
        return np.flatnonzero(self.broken[before : before + len(track) - 1])

    def ends_in(self, session: str) -> NDArray[np.int64]:
        """The submaps (n,) of a session at which loops end that hold, each as often as loops end there."""
        nodes = [node for one in self.loops for node in (one.match, one.query) if node.session == session]
        return np.array([node.ordinal for node in nodes], dtype=np.int64)


def _odd(track: Trajectory) -> NDArray[np.bool_]:
    """Which steps (n,) are unlike all of those near them: lengths come in turns where scans are far apart."""
    motions = steps_of(track)
    way_m = np.median(np.linalg.norm(motions[:, :3, 3], axis=1)) if len(motions) else 0.0
    odd = np.full(len(motions), len(motions) > 1)
    for along in range(1, min(NEAR_STEPS, len(motions) - 1) + 1):
        apart = se3_rows.log(se3_rows.inverse(motions[:-along]) @ motions[along:])
        lengths, turns = np.linalg.norm(apart[:, :3], axis=1), np.linalg.norm(apart[:, 3:], axis=1)
        unlike = (lengths > UNLIKE_SHARE * way_m) | (turns > UNLIKE_RAD)
        odd[along:] &= unlike
        odd[:-along] &= unlike
    return odd


@dataclass(frozen=True)
class _Event:
    """Broken steps that are one fault.

    correction (6,) in the frame of the map: by how much the fault moves all behind it, about itself, `at` (3,). loops
    and places that speak for it, before and behind.
    """

    mending: Mending
    correction: Array64
    at: Array64
    loops: tuple[int, int]
    places: tuple[int, int]

    @property
    def is_certain(self) -> bool:
        """Whether loops decide, and no surfaces are asked."""
        return min(self.places) >= LEAST_PLACES and float(np.linalg.norm(self.correction[3:])) <= MOST_RAD

    @property
    def size(self) -> float:
        """How large the correction is, metres."""
        return float(np.linalg.norm(self.correction[:3]) + LEVER_M * np.linalg.norm(self.correction[3:]))


def _events(held: _Held, track: Trajectory) -> list[_Event]:
    """The faults of a session in their order."""
    broken = held.broken_of(track)
    if not len(broken):
        return []
    groups = np.split(broken, np.flatnonzero(np.diff(broken) > APART) + 1)
    borders = [0, *(int(one[-1]) + 1 for one in groups)], [*(int(one[0]) for one in groups), len(track) - 1]
    ends = held.ends_in(track.session)
    sides = [ends[(ends >= first) & (ends <= last)] for first, last in zip(*borders, strict=True)]
    return [
        _event(held, track, groups[n], sides[n], sides[n + 1])
        for n in range(len(groups))
        if len(sides[n]) and len(sides[n + 1])
    ]


def _event(
    held: _Held,
    track: Trajectory,
    steps: NDArray[np.int64],
    before: NDArray[np.int64],
    behind: NDArray[np.int64],
) -> _Event:
    """A fault between the loops of both its sides; where between them, only an odd step tells."""
    first, last = int(before.max()), int(behind.min())
    odd = first + np.flatnonzero(_odd(track)[first:last])
    if len(odd) and np.isin(odd, steps).all():
        first, last = int(odd[0]), int(odd[-1]) + 1
    T_map_submap = held.poses[track.session]
    stated = se3_rows.inverse(track.T_odom_submap[first : first + 1]) @ track.T_odom_submap[first : last + 1]
    T_first_last = se3.inverse(T_map_submap[first]) @ T_map_submap[last]
    tangent = se3.log(se3.inverse(stated[-1]) @ T_first_last)
    kind, amount = _kind(stated, T_first_last, track.T_odom_submap[first, 2, :3])
    count = last - first
    variances = (LOOSER - 1.0) * np.diagonal(track.step_covariances[first:last], axis1=1, axis2=2)
    variances = variances + np.repeat([tangent[:3] @ tangent[:3], tangent[3:] @ tangent[3:]], 3) / count
    of_axis = slice(0, 3) if kind in (FaultKind.SLIP, FaultKind.JUMP) else slice(3, 6)
    sigma = float(np.sqrt(track.step_covariances[first:last, of_axis, of_axis].trace(axis1=1, axis2=2).sum() / 3.0))
    fault = OdometryFault(track.session, kind, first, last, amount, sigma, min(len(before), len(behind)))
    turn = T_map_submap[last][:3, :3]
    in_map = np.concatenate([turn @ tangent[:3], turn @ tangent[3:]])
    mending = Mending(fault, _spread(stated, T_first_last), variances)
    at = T_map_submap[last][:3, 3]
    return _Event(mending, in_map, at, (len(before), len(behind)), (_places(before), _places(behind)))


def _spread(stated: Array64, T_first_last: se3.Matrix4) -> Array64:
    """The steps (n, 4, 4) of a way (n + 1, 4, 4) that ends elsewhere than it states, by even shares."""
    whole = se3.log(T_first_last @ se3.inverse(stated[-1]))
    shares = np.linspace(0.0, 1.0, len(stated))[:, None] * whole
    poses = se3_rows.exp(shares) @ stated
    return np.asarray(se3_rows.inverse(poses[:-1]) @ poses[1:])


def _kind(stated: Array64, T_first_last: se3.Matrix4, up: Array64) -> tuple[FaultKind, float]:
    """Kind and size of a fault, by the stated way (n, 4, 4), the true motion along it, and the vertical `up` (3,).

    All of them in the frame of the first submap, which the sensor may tilt.

    It is a turn where that is more than the shift at the pose of the way that is shifted least: a turn shifts all but
    the pose that it happened at.
    """
    T_true_stated = T_first_last @ se3.inverse(stated[-1])
    moved = T_true_stated @ stated
    least = int(np.linalg.norm(moved[:, :3, 3] - stated[:, :3, 3], axis=1).argmin())
    shift, turn = (moved - stated)[least, :3, 3], se3.log(T_true_stated)[3:]
    size = float(np.linalg.norm(turn))
    if size > LEAST_RAD and LEVER_M * size > np.linalg.norm(shift):
        upright = abs(float(up @ turn)) >= 0.7 * size
        return (FaultKind.TURN if upright else FaultKind.TILT), size
    way = T_first_last[:3, 3]
    length = float(np.linalg.norm(way))
    ahead = way / length if length > 0.1 else np.array([1.0, 0.0, 0.0])
    is_slip = abs(float(ahead @ shift)) >= 0.7 * float(np.linalg.norm(shift))
    return (FaultKind.SLIP if is_slip else FaultKind.JUMP), float(np.linalg.norm(shift))


def _places(ends: NDArray[np.int64]) -> int:
    """How many places loops show that end at these submaps (n,): a stretch is one, however many loops there are."""
    return len(np.unique((ends - ends.min()) // STRETCH))


def _is_possible(event: _Event, events: Sequence[_Event]) -> bool:
    """Whether a fault is one but for the places that show it: see the beginning of this file."""
    shift = np.linalg.norm(event.correction[:3])
    if min(event.loops) < LEAST_LOOPS or shift > MOST_M:
        return False
    return not any(_come_back(event, other) for other in events if other is not event)


def _come_back(one: _Event, other: _Event) -> bool:
    """Whether two faults leave the sessions beyond both where odometry has them: only the stretch between is misplaced.

    A fault of another session moves its surroundings the other way.
    """
    same = one.mending.fault.session == other.mending.fault.session
    there = one.correction.copy()
    there[:3] += np.cross(there[3:], other.at - one.at)
    both = replace(other, correction=there + (1.0 if same else -1.0) * other.correction)
    return both.size < SMALL_SHARE * max(one.size, other.size)
