"""The most likely poses of a graph, and which loops they rest on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchors import Anchor, Georeference, JudgedAnchor, require_anchors
from revisit.core.pose_graph.broken_steps import Steps, StepSearch, broken_steps, is_bent, shows_a_fault
from revisit.core.pose_graph.consistency import ConsistentSet, consistent_sets
from revisit.core.pose_graph.faults import MOST_SOLVED_TWICE, Mending, OdometryFault, doubt
from revisit.core.pose_graph.graph import GraphState, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.grounding import Grounding, Solution
from revisit.core.pose_graph.heading_bias import straightened
from revisit.core.pose_graph.held_component import HeldComponent
from revisit.core.pose_graph.jumps import without_jumps
from revisit.core.pose_graph.least_squares import ROUGHLY, Kernel, cauchy, graduated, huber, minimise, settled
from revisit.core.pose_graph.normal_equations import Edges, Factorisation
from revisit.core.pose_graph.odometry_weights import by_weighed_odometry
from revisit.core.pose_graph.placement import Component, place_sessions
from revisit.core.pose_graph.steady_faults import steady_faults
from revisit.core.pose_graph.support import LoopsWithin, joined_stretches, supported_loops
from revisit.core.pose_graph.variance_factor import LEAST, rescaled, variance_factor

Array64 = NDArray[np.float64]

GATE = 22.5
"""Squared Mahalanobis distance of a loop from the poses: chi-square with 6 degrees of freedom, 99.9 %."""

WIDE_GATE = 100.0
"""Squared Mahalanobis distance beyond which a loop is set aside before the first exact solution."""

MAX_GATINGS = 5

MAX_MENDINGS = 3
"""How often broken steps are sought again: a mended one may show others."""

ALIKE = 1.0
"""By how much answers may differ that blame one fault on either of two sessions: no loop tells which."""

FAULT_PRICE = 2 * GATE
"""The least that a fault of odometry must explain: as much as two loops that are set aside."""

LEAST_PLACES, FIT_SLACK = 10, 5.0
"""Places that say, at least, that a graph fits better than it states; and how many times better it may."""

MAX_VOUCHED = 100
"""Loops, at most, that are held against the covariances of the poses."""


class Robustness(StrEnum):
    """How wrong loops are kept from bending the map.

    PLAIN, HUBER and GNC (graduated non-convexity, Yang et al. 2020, on all loops) are for comparison only. ONLINE:
    Cauchy weights on the loops that others support, then gates. COMMIT: that, and where not everything fits, graduated
    non-convexity beside it; the answer that explains steps and loops better is taken.
    """

    PLAIN = "plain"
    HUBER = "huber"
    GNC = "gnc"
    ONLINE = "online"
    COMMIT = "commit"


@dataclass(frozen=True)
class OptimisedGraph:
    """Poses and the loops they rest on.

    T_map_submap (n, 4, 4) of each session; components, the sessions that share a frame, the first of which gives it;
    loops, the state of every loop of the graph in its order; residuals (l,), its squared Mahalanobis distance from the
    poses, NaN where its sessions share no frame. covariances (n, 6, 6) of the poses of each session, of the tangent
    (x, y, z, rx, ry, rz) in the submap's frame, metres and radians, as of the first submap of the component, which is
    held fast; NaN where they are too large to be computed. chi2, the squared errors of all steps and of the loops and
    anchors in the map; degrees_of_freedom, its expectation. faults: those of the odometry that were mended before, and
    undecided ones: these the poses do not have mended, those of `otherwise` do, and the covariances allow for both.
    otherwise is None, too, where the graph has more than MOST_SOLVED_TWICE submaps.
    anchors: the verdicts on the anchors, in the order given; georeferences, of the components that they hold.
    T_odom_submap (n, 4, 4): the odometry of each session as the poses have it, with faults mended.
    """

    T_map_submap: dict[str, Array64]
    components: tuple[tuple[str, ...], ...]
    loops: tuple[GraphState, ...]
    residuals: Array64
    covariances: dict[str, Array64]
    chi2: float
    degrees_of_freedom: int
    faults: tuple[OdometryFault, ...] = ()
    anchors: tuple[JudgedAnchor, ...] = ()
    georeferences: tuple[Georeference, ...] = ()
    otherwise: OptimisedGraph | None = None
    T_odom_submap: dict[str, Array64] = field(default_factory=dict)

    @property
    def price(self) -> float:
        """Squared errors of the steps and the loops in the map; each other loop costs as much as the gate."""
        return self.chi2 + GATE * sum(state is not GraphState.IN_MAP for state in self.loops)

    def T_map_odom(self, trajectory: Trajectory) -> se3.Matrix4:
        """The correction of a session: where its odometry frame lies in the map, as of its last submap."""
        return np.asarray(self.T_map_submap[trajectory.session][-1] @ se3.inverse(trajectory.T_odom_submap[-1]))


def optimise(
    graph: PoseGraph,
    robustness: Robustness = Robustness.COMMIT,
    progress: Callable[[int, int], None] = lambda *_: None,
    anchors: Sequence[Anchor] = (),
) -> OptimisedGraph:
    """Place the sessions by the loops that agree, optimise each component, set loops aside that do not fit.

    Uncertainties that small circles show to be far too large are reduced before (see `variance_factor`), and odometry
    whose heading turns steadily is straightened (see `heading_bias`), but for PLAIN and the other methods that are for
    comparison; covariances and distances in the answer rest on the reduced ones and on the straight odometry.
    `progress` hears how many of how many components are done, and may raise to end the work.
    `anchors` hold what the loops have made of each component in the world, and set no loop aside (see `grounding`);
    those methods do without them. Raises BadField where one names no submap, or has numbers that are none.
    """
    return by_loops(graph, robustness, progress).held(anchors)


@dataclass(frozen=True)
class SolvedByLoops:
    """The answer by drives and loops, and the graph as that has it; `otherwise`, with undecided faults mended.

    Anchors hold none of a method for comparison.
    """

    graph: PoseGraph
    answer: OptimisedGraph
    may_hold: bool
    otherwise: _Otherwise | None = None

    def held(self, anchors: Sequence[Anchor]) -> OptimisedGraph:
        """The answer by these anchors, too. Raises BadField where one names no submap, or has numbers that are none."""
        require_anchors(anchors, {one.session: len(one) for one in self.graph.trajectories})
        answer, other = self.answer, self.otherwise
        if anchors and self.may_hold:
            answer = _on_earth(self.graph, answer, anchors)
            other = other and replace(other, answer=_on_earth(other.graph, other.answer, anchors))
        return answer if other is None else _undecided(answer, other.answer, other.mendings)


def by_loops(
    graph: PoseGraph, robustness: Robustness = Robustness.COMMIT, progress: Callable[[int, int], None] = lambda *_: None
) -> SolvedByLoops:
    """See `optimise`: what it finds before it asks the anchors, which is the same whatever these are.

    Undecided faults of a large graph are told alone.
    """
    if robustness not in (Robustness.ONLINE, Robustness.COMMIT):
        return SolvedByLoops(graph, _judged(graph, robustness, progress), may_hold=False)
    graph, jumped = without_jumps(graph)
    graph = straightened(rescaled(graph, variance_factor(graph)))
    answer, doubtful = _judged(graph, robustness, progress), list[list[Mending]]()
    if robustness is Robustness.COMMIT:
        graph, answer, doubtful = _without_faults(graph, answer, progress)
    answer = replace(answer, faults=_in_order([*answer.faults, *jumped]))
    if sum(map(len, graph.trajectories)) > MOST_SOLVED_TWICE:
        told = [one.fault for some in doubtful[:1] for one in some]
        answer = replace(_weighed(graph, answer), faults=_in_order([*answer.faults, *told]))
        return SolvedByLoops(graph, answer, may_hold=True)
    found = [_Otherwise(one, mended := _mended(graph, one), _judged(mended, robustness, progress)) for one in doubtful]
    better = [one for one in found if _explains_more(one.answer, answer, len(one.mendings))]
    least = min((one.answer.price for one in better), default=0.0)
    as_good = [one for one in better if one.answer.price < least + GATE]
    fewest = min((one.steps for one in as_good), default=0)
    precise = [one for one in as_good if one.steps == fewest]
    chosen = next((one for one in precise if one.answer.price < min(it.answer.price for it in precise) + ALIKE), None)
    other = chosen and replace(chosen, answer=_weighed(chosen.graph, chosen.answer))
    return SolvedByLoops(graph, _weighed(graph, answer), may_hold=True, otherwise=other)


@dataclass(frozen=True)
class _Otherwise:
    """Mendings of undecided faults, the graph with them, and its answer."""

    mendings: Sequence[Mending]
    graph: PoseGraph
    answer: OptimisedGraph

    @property
    def steps(self) -> int:
        """Any of which may be broken."""
        return sum(one.fault.last - one.fault.first for one in self.mendings)


def _undecided(answer: OptimisedGraph, other: OptimisedGraph, mendings: Sequence[Mending]) -> OptimisedGraph:
    """The answer of a graph where faults are undecided, whose poses may as well be those of the `other` one."""
    faults = _in_order([*answer.faults, *(one.fault for one in mendings)])
    frame, frame_otherwise = _frames(answer), _frames(other)
    covariances = {
        session: its + doubt(answer.T_map_submap[session], other.T_map_submap[session])
        for session, its in answer.covariances.items()
        if frame[session] == frame_otherwise[session]
    }
    otherwise = replace(other, faults=faults)
    return replace(answer, covariances=answer.covariances | covariances, faults=faults, otherwise=otherwise)


def _frames(answer: OptimisedGraph) -> dict[str, str]:
    """The session that gives the frame of each."""
    return {session: group[0] for group in answer.components for session in group}


def _in_order(faults: Iterable[OdometryFault]) -> tuple[OdometryFault, ...]:
    return tuple(sorted(faults, key=lambda one: (one.session, one.first, one.kind)))


def _on_earth(graph: PoseGraph, answer: OptimisedGraph, anchors: Sequence[Anchor]) -> OptimisedGraph:
    """The answer held by anchors, a component after the other; as it was where they do not tell its place."""
    judged: dict[int, JudgedAnchor] = {}
    for group in answer.components:
        numbers = [n for n, one in enumerate(anchors) if one.node.session in group]
        if numbers:
            component = HeldComponent.of(graph, answer.loops, answer.T_map_submap, group)
            found = Grounding.of(component, [anchors[n] for n in numbers]).solved()
            judged |= dict(zip(numbers, found.anchors, strict=True))
            answer = answer if found.solution is None else _held(answer, found.solution)
    return replace(answer, anchors=tuple(judged[n] for n in range(len(anchors))))


def _weighed(graph: PoseGraph, answer: OptimisedGraph) -> OptimisedGraph:
    """The answer with odometry as sure as each component shows it. Verdicts on loops and covariances stay those by
    the drift that is stated: an error that sessions share does not show.
    """
    for group in answer.components:
        component = HeldComponent.of(graph, answer.loops, answer.T_map_submap, group)
        poses = by_weighed_odometry(component.trajectories, component.edges, 0, component.before)
        if poses is not component.before:
            chi2_more = component.squared_errors(poses) - component.squared_errors(component.before)
            answer = replace(
                answer,
                T_map_submap=answer.T_map_submap | component.by_session(poses),
                residuals=_with_residuals(answer, component.squared_distances(poses)),
                chi2=answer.chi2 + chi2_more,
            )
    return answer


def _with_residuals(answer: OptimisedGraph, changed: Mapping[int, float]) -> Array64:
    """The residuals (l,) of an answer, with those of some loops, by number, as they are now."""
    residuals = answer.residuals.copy()
    residuals[list(changed)] = list(changed.values())
    return residuals


def _held(answer: OptimisedGraph, solution: Solution) -> OptimisedGraph:
    """The answer with one component as its anchors hold it."""
    return replace(
        answer,
        T_map_submap=answer.T_map_submap | solution.T_map_submap,
        covariances=answer.covariances | solution.covariances,
        residuals=_with_residuals(answer, solution.residuals),
        chi2=answer.chi2 + solution.chi2_more,
        degrees_of_freedom=answer.degrees_of_freedom + solution.degrees_more,
        georeferences=(*answer.georeferences, solution.georeference),
    )


@dataclass(frozen=True)
class _Fit:
    """A graph and its answer, in which faults are sought in several ways."""

    graph: PoseGraph
    answer: OptimisedGraph

    @cached_property
    def supported(self) -> frozenset[int]:
        """The loops that others support, by number."""
        return supported_loops(self.graph)

    @cached_property
    def searches(self) -> list[StepSearch]:
        """Those for broken steps, of components where supported loops are set aside, or a step is bent."""
        graph, states, found = self.graph, self.answer.loops, list[StepSearch]()
        for group in self.answer.components:
            poses = {session: self.answer.T_map_submap[session] for session in group}
            inside = [
                n for n, one in enumerate(graph.loops) if one.match.session in poses and one.query.session in poses
            ]
            kept = {n for n in inside if states[n] is GraphState.IN_MAP}
            left = {n for n in self.supported.intersection(inside) - kept if shows_a_fault(graph.loops[n], poses)}
            if left or is_bent(graph, kept, poses):
                found.append(StepSearch.of(graph, kept, left, poses))
        return found


Seeking = Callable[[_Fit], list[Mending]]
"""A way to seek faults of odometry."""


def _without_faults(
    graph: PoseGraph, answer: OptimisedGraph, progress: Callable[[int, int], None]
) -> tuple[PoseGraph, OptimisedGraph, list[list[Mending]]]:
    """Graph and answer with faults of odometry mended, as long as that explains more of the loops; or as they are. And
    undecided ones, by one way to seek them, and another.
    """
    fit, faults = _Fit(graph, answer), list[OdometryFault]()
    doubtful: list[list[Mending]] = []
    broken: list[Seeking] = [partial(_broken, steps=steps) for steps in Steps]
    ways: list[tuple[Seeking, int]] = [(_steady, 1), *((one, MAX_MENDINGS) for one in broken)]
    for sought, rounds in ways:
        for _ in range(rounds):
            found = sought(fit)
            more = [one for one in found if not one.fault.undecided]
            mended = _mended(fit.graph, more)
            other = _judged(mended, Robustness.COMMIT, progress) if more else fit.answer
            if not _explains_more(other, fit.answer, len(more)) or _blames_even_steps(
                fit, doubtful, more, other, progress
            ):
                doubtful += [unsure] if (unsure := [one for one in found if one.fault.undecided]) else []
                break
            fit, faults, doubtful = _Fit(mended, other), faults + [one.fault for one in more], []
    return fit.graph, replace(fit.answer, faults=_in_order(faults)), doubtful


def _blames_even_steps(
    fit: _Fit, doubtful: Sequence[Sequence[Mending]], found: Sequence[Mending], other: OptimisedGraph,
    progress: Callable[[int, int], None],
) -> bool:  # fmt: skip
    """Whether `found` faults, and the `other` answer with them, blame other steps than undecided ones do, which were
    sought first, among odd steps, and explain as much.
    """
    if sum(map(len, fit.graph.trajectories)) > MOST_SOLVED_TWICE:
        return False
    blamed = [[all(not it.fault.is_beside(one.fault) for it in unsure) for one in found] for unsure in doubtful]
    odd = [unsure for unsure, elsewhere in zip(doubtful, blamed, strict=True) if any(elsewhere)]
    answers = (_judged(_mended(fit.graph, unsure), Robustness.COMMIT, progress) for unsure in odd)
    return any(answer.price < other.price + ALIKE for answer in answers)


def _mended(graph: PoseGraph, mendings: Sequence[Mending]) -> PoseGraph:
    """The graph with the odometry of its sessions mended."""
    tracks = dict(graph.by_session)
    for one in mendings:
        tracks[one.fault.session] = one.applied(tracks[one.fault.session])
    return replace(graph, trajectories=tuple(tracks[one.session] for one in graph.trajectories))


def _steady(fit: _Fit) -> list[Mending]:
    """Steady faults of sessions that share a frame."""
    found: list[Mending] = []
    for group in fit.answer.components:
        if len(group) > 1:
            found += steady_faults(fit.graph, fit.supported, group)
    return found


def _broken(fit: _Fit, steps: Steps) -> list[Mending]:
    """The broken ones of some steps of all components."""
    return [one for search in fit.searches for one in broken_steps(search, steps)]


def _explains_more(other: OptimisedGraph, answer: OptimisedGraph, faults: int) -> bool:
    """Whether an answer with so many faults mended costs less than one without: a fault costs FAULT_PRICE."""
    return other.price + FAULT_PRICE * faults < answer.price


def _judged(graph: PoseGraph, robustness: Robustness, progress: Callable[[int, int], None]) -> OptimisedGraph:
    """Poses and loops by the odometry as it is."""
    sets, within = consistent_sets(graph), LoopsWithin.of(graph)
    components = [one.anchored(graph.anchors) for one in place_sessions(graph, sets)]
    trusted = Trusted.of(graph, sets, within)
    poses: dict[str, Array64] = {}
    covariances: dict[str, Array64] = {}
    chi2, degrees_of_freedom = 0.0, 0
    states = [GraphState.UNCONNECTED] * len(graph.loops)
    residuals = np.full(len(graph.loops), np.nan)
    for done, component in enumerate(components):
        progress(done, len(components))
        problem = Problem.of(graph, component, trusted)
        judging, solution, kept = _solve(problem, robustness)
        covariances.update(problem.by_session(problem.covariances(solution, kept)))
        chi2 += problem.squared_errors(solution, kept)
        degrees_of_freedom += problem.degrees_of_freedom(kept)
        poses.update(problem.by_session(solution))
        for number, residual in zip(problem.loops, judging.residuals(solution), strict=True):
            residuals[number] = residual
            states[number] = GraphState.IN_MAP if number in kept else GraphState.SET_ASIDE
    groups = tuple(tuple(one.T_map_odom) for one in components)
    odometry = {one.session: one.T_odom_submap for one in graph.trajectories}
    return OptimisedGraph(
        poses, groups, tuple(states), residuals, covariances, chi2, degrees_of_freedom, T_odom_submap=odometry
    )


@dataclass(frozen=True)
class Trusted:
    """Loops by their place in the graph: all that may be right at all (those between sessions agree with others); those
    to begin with, which others support; those that wait for better poses. Some of the first ones may speak for others,
    by number: then these follow where those are believed.
    """

    possible: frozenset[int]
    first: frozenset[int]
    waiting: frozenset[int]
    speakers: dict[int, tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, graph: PoseGraph, sets: list[ConsistentSet], within: LoopsWithin) -> Trusted:
        """The loops of the graph by consistency between sessions and support within them."""
        between = frozenset[int]().union(*(one.loops for one in sets))
        in_one = {n for n, loop in enumerate(graph.loops) if loop.match.session == loop.query.session}
        spoken_for = frozenset(itertools.chain.from_iterable(within.speakers.values()))
        first = (between | within.supported) - spoken_for | within.speakers.keys()
        return cls(between | in_one, first, within.allowed - within.supported, within.speakers)

    def among(self, loops: Iterable[int]) -> Trusted:
        """The same for some of the loops."""
        some = frozenset(loops)
        speakers = {number: others for number, others in self.speakers.items() if number in some}
        return Trusted(self.possible & some, self.first & some, self.waiting & some, speakers)

    def with_spoken_for(self, loops: set[int]) -> set[int]:
        """These loops, and those that they speak for."""
        return loops.union(*(self.speakers.get(number, ()) for number in loops))


@dataclass(frozen=True)
class Problem:
    """A component as arrays: steps first, then loops, between poses in the order of the trajectories, and a start.

    loops: numbers in the graph of the loops within the component; trusted: those of them that may be used; edges: the
    `steps` of odometry, then these loops; anchor: the row of the pose that is held fast; start (n, 4, 4); places (l,):
    the number of the place that each of the loops shows; shares (l,): their independent shares.
    """

    trajectories: tuple[Trajectory, ...]
    loops: tuple[int, ...]
    trusted: Trusted
    edges: Edges
    steps: int
    anchor: int
    start: Array64
    places: NDArray[np.int64]
    shares: Array64

    @classmethod
    def of(cls, graph: PoseGraph, component: Component, trusted: Trusted) -> Problem:
        """The component's part of the graph, everything in canonical order: two runs are equal byte for byte."""
        trajectories = tuple(one for one in graph.trajectories if one.session in component.T_map_odom)
        nodes = [Node(one.session, ordinal) for one in trajectories for ordinal in range(len(one))]
        rows = {node: row for row, node in enumerate(nodes)}
        loops = {n: loop for n, loop in enumerate(graph.loops) if loop.match in rows and loop.query in rows}
        steps = Edges.of_steps(trajectories, rows)
        return cls(
            trajectories, tuple(loops), trusted.among(loops), steps.joined(Edges.of_loops(list(loops.values()), rows)),
            len(steps), rows[Node(component.anchor, 0)],
            np.concatenate([component.T_map_odom[one.session] @ one.T_odom_submap for one in trajectories]),
            joined_stretches(list(loops.values())),
            np.array([loop.independent_share for loop in loops.values()]),
        )  # fmt: skip

    def graph(self, loops: Iterable[int]) -> Edges:
        """The steps and some loops, by number."""
        return self.edges.chosen(self._chosen(loops))

    def residuals(self, poses: Array64) -> Array64:
        """Squared Mahalanobis distance of every loop of the component."""
        return self.edges.squared_errors(poses)[self.steps :]

    def squared_errors(self, poses: Array64, kept: set[int]) -> float:
        """Those of the steps and the `kept` loops, summed."""
        return float(self.edges.squared_errors(poses)[self._chosen(kept)].sum())

    def with_kernel(self, of_loops: Kernel) -> Kernel:
        """A kernel for loops behind the steps, which count as they are."""

        def of_all(squared: Array64) -> tuple[Array64, Array64]:
            costs, weights = of_loops(squared[self.steps :])
            steps = squared[: self.steps]
            return np.concatenate([steps, costs]), np.concatenate([np.ones_like(steps), weights])

        return of_all

    def degrees_of_freedom(self, kept: set[int]) -> int:
        """The degrees of freedom of the steps and the `kept` loops."""
        return 6 * (len(kept) - len(self.trajectories) + 1)

    def factorised(self, poses: Array64, kept: set[int]) -> Factorisation:
        """The equations of the steps and the `kept` loops at the poses. Raises RuntimeError where there is none."""
        edges = self.graph(kept)
        return edges.linearised(poses, edges.errors(poses), np.ones(len(edges))).factorised(self.anchor)

    def covariances(self, poses: Array64, kept: set[int]) -> Array64:
        """The marginal covariances (n, 6, 6) of the poses; NaN where they are too large to be computed."""
        try:
            return self.factorised(poses, kept).covariances()
        except RuntimeError:
            return np.full((len(poses), 6, 6), np.nan)

    def by_session(self, values: Array64) -> dict[str, Array64]:
        """Values (n, ...) of all poses, by the session they belong to."""
        ends = np.cumsum([len(one) for one in self.trajectories])
        return {one.session: part for one, part in zip(self.trajectories, np.split(values, ends[:-1]), strict=True)}

    def _chosen(self, loops: Iterable[int]) -> NDArray[np.int64]:
        """The rows of the steps and of some loops."""
        some = self.steps + np.flatnonzero(np.isin(self.loops, list(loops)))
        return np.concatenate([np.arange(self.steps), some])


def _solve(problem: Problem, robustness: Robustness) -> tuple[Problem, Array64, set[int]]:
    """The problem by which loops are judged, as sure as the fit says; the poses, and the loops they rest on."""
    if robustness in (Robustness.PLAIN, Robustness.HUBER, Robustness.GNC):
        return problem, *_compared(problem, robustness)
    answers = _answers(problem, robustness)
    factor = min(_fitted_factor(problem, *answer) for answer in answers)
    if factor < 1.0:
        problem = replace(problem, edges=problem.edges.weighted(np.full(len(problem.edges), 1.0 / factor)))
        answers = _answers(problem, robustness)
    return problem, *min(answers, key=lambda answer: _cost(problem, *answer))


def _answers(problem: Problem, robustness: Robustness) -> list[tuple[Array64, set[int]]]:
    """Poses and the loops they rest on, in one way or two."""
    poses, kept = _by_gates(problem)
    answers = [_regated(problem, poses)]
    if robustness is Robustness.COMMIT and not _fits_throughout(problem, *answers[0]):
        answers.append(_regated(problem, _graduated(problem, set(problem.trusted.first | kept))))
    return answers


def _fitted_factor(problem: Problem, poses: Array64, kept: set[int]) -> float:
    """The factor for all covariances by how well the answer fits: 1 unless that is far better than they state.

    Wrong loops are within the gates of a graph that states a hundred times its errors, and bend it by these.
    """
    heard = np.isin(problem.loops, list(kept))
    if len(np.unique(problem.places[heard])) < LEAST_PLACES:
        return 1.0
    expected = 6.0 * (problem.shares[heard].sum() - len(problem.trajectories) + 1)
    return float(np.clip(FIT_SLACK * problem.squared_errors(poses, kept) / expected, LEAST, 1.0))


def _fits_throughout(problem: Problem, poses: Array64, kept: set[int]) -> bool:
    """Whether no loop is set aside, and all errors together are no larger than the graph states them."""
    all_kept = len(kept) == len(problem.loops)
    return all_kept and _cost(problem, poses, kept) <= problem.degrees_of_freedom(kept)


def _compared(problem: Problem, robustness: Robustness) -> tuple[Array64, set[int]]:
    """The methods that are for comparison, on all loops."""
    possible = set(problem.trusted.possible)
    if robustness is Robustness.PLAIN:
        return _minimised(problem, problem.start, possible), possible
    if robustness is Robustness.HUBER:
        kernel = problem.with_kernel(huber)
        return minimise(problem.graph(possible), problem.anchor, problem.start, kernel=kernel), possible
    poses = _graduated(problem, possible)
    return poses, _within(problem, poses, possible, GATE)


def _minimised(problem: Problem, poses: Array64, loops: set[int]) -> Array64:
    """The poses of least cost near `poses`, by the steps and some loops."""
    return minimise(problem.graph(loops), problem.anchor, poses)


def _cost(problem: Problem, poses: Array64, kept: set[int]) -> float:
    """Squared errors of the steps and the kept loops; a loop that is set aside costs as much as the gate."""
    set_aside = len(problem.loops) - len(kept)
    return problem.squared_errors(poses, kept) + GATE * set_aside


def _by_gates(problem: Problem) -> tuple[Array64, set[int]]:
    """Cauchy weights first, under which wrong loops pull little; then the loops near those poses, exactly; then those
    that lie where these poses expect them, also loops that nothing supports.
    """
    first = set(problem.trusted.first)
    poses, kept = _by_cauchy(problem, problem.start, first)
    if problem.trusted.speakers:
        poses, kept = _with_spoken_for(problem, poses, kept)
    usable = problem.trusted.with_spoken_for(first | problem.trusted.waiting)
    for _ in range(MAX_GATINGS):
        expected = _expected(problem, poses, kept, usable - kept)
        if not expected:
            break
        poses, kept = _gated(problem, poses, usable, WIDE_GATE, kept | expected)
    return poses, kept


def _with_spoken_for(problem: Problem, poses: Array64, kept: set[int]) -> tuple[Array64, set[int]]:
    """The poses by the loops that the `kept` ones speak for, too; more speakers join where these expect them."""
    for _ in range(MAX_GATINGS):
        believed = kept | _expected(problem, poses, kept, set(problem.trusted.first) - kept)
        heard = problem.trusted.with_spoken_for(believed)
        if heard <= kept:
            break
        before, (poses, kept) = kept, _by_cauchy(problem, poses, heard)
        if kept == before:
            break
    return poses, kept


def _by_cauchy(problem: Problem, start: Array64, loops: set[int]) -> tuple[Array64, set[int]]:
    """The poses by some loops with Cauchy weights, then by those near these poses, exactly; and which those are."""
    roughly = minimise(problem.graph(loops), problem.anchor, start, ROUGHLY, problem.with_kernel(cauchy))
    return _gated(problem, roughly, loops, WIDE_GATE)


def _gated(
    problem: Problem, poses: Array64, usable: set[int], gate: float, kept: set[int] | None = None
) -> tuple[Array64, set[int]]:
    """The poses by the loops within a gate around them: loops return as the poses come nearer to them.

    `kept` are the loops to begin with, instead of those within the gate around `poses`.
    """
    kept = _within(problem, poses, usable, gate) if kept is None else kept
    for _ in range(MAX_GATINGS):
        poses = _minimised(problem, poses, kept)
        before, kept = kept, _within(problem, poses, usable, gate)
        if kept == before:
            break
    return poses, kept


def _expected(problem: Problem, poses: Array64, kept: set[int], waiting: set[int]) -> set[int]:
    """The waiting loops within the gate around the poses; the uncertainty of the poses themselves is counted too where
    there are few. Where odometry allows many that do not fit, it is too unsure of itself to vouch for any.
    """
    near = _within(problem, poses, waiting, GATE)
    if not waiting - near or len(waiting) > MAX_VOUCHED:
        return near
    try:
        known = problem.factorised(poses, kept)
    except RuntimeError:  # too large to be computed: long chains that nothing ties
        return near
    return near | {n for n in sorted(waiting - near) if _distance(problem, poses, known, n) < GATE}


def _distance(problem: Problem, poses: Array64, known: Factorisation, number: int) -> float:
    """Squared Mahalanobis distance of a loop that is not among the `known` edges from poses with their covariances."""
    row = problem.steps + problem.loops.index(number)
    edge = problem.edges.chosen(np.array([row]))
    first, second = int(edge.first[0]), int(edge.second[0])
    back = se3.adjoint(se3.inverse(poses[second]) @ poses[first])
    moving = known.half_at({first: -back.T, second: np.eye(6)})  # the motion of the second pose, as seen from the first
    covariance = moving.product(moving) + np.linalg.inv(edge.information[0])
    error = edge.errors(poses)[0]
    return float(error @ np.linalg.solve(covariance, error))


def _regated(problem: Problem, poses: Array64) -> tuple[Array64, set[int]]:
    """Every loop that fits the poses by now is in the map, also loops that agreed with no others before."""
    kept = _within(problem, poses, set(problem.loops), GATE)
    edges = problem.graph(kept)
    return settled(edges, problem.anchor, minimise(edges, problem.anchor, poses)), kept


def _within(problem: Problem, poses: Array64, usable: set[int], gate: float) -> set[int]:
    residuals = zip(problem.loops, problem.residuals(poses), strict=True)
    return {number for number, residual in residuals if number in usable and residual < gate}


def _graduated(problem: Problem, usable: set[int]) -> Array64:
    """Graduated non-convexity on some loops: steps are known to be right."""
    if not usable:
        return problem.start
    return graduated(problem.graph(usable), problem.steps, problem.anchor, problem.start)
