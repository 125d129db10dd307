"""The most likely poses of a graph, and which loops they rest on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import gtsam
import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.consistency import ConsistentSet, consistent_sets
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.least_squares import ROUGHLY, graduated, minimise
from revisit.core.pose_graph.marginal_covariances import marginal_covariances
from revisit.core.pose_graph.placement import Component, place_sessions
from revisit.core.pose_graph.support import LoopsWithin
from revisit.core.pose_graph.variance_factor import rescaled, variance_factor

Array64 = NDArray[np.float64]

GATE = 22.5
"""Squared Mahalanobis distance of a loop from the poses: chi-square with 6 degrees of freedom, 99.9 %."""

WIDE_GATE = 100.0
"""Squared Mahalanobis distance beyond which a loop is set aside before the first exact solution."""

MAX_GATINGS = 5

MAX_SETTLING = 6
SETTLED_STEP = 1e-7
"""Length of a step of all poses together, metres and radians, after which they are where they belong."""

MAX_VOUCHED = 100
"""Loops, at most, that are held against the covariances of the poses."""

_ROTATION_FIRST = [3, 4, 5, 0, 1, 2]
_TRANSLATION_FIRST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
_ANCHOR_SIGMA = 1e-4


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


class LoopState(StrEnum):
    """What the graph says of a loop."""

    IN_MAP = "IN_MAP"
    SET_ASIDE = "SET_ASIDE"
    UNCONNECTED = "UNCONNECTED"


@dataclass(frozen=True)
class OptimisedGraph:
    """Poses and the loops they rest on.

    T_map_submap (n, 4, 4) of each session; components, the sessions that share a frame, the first of which gives it;
    loops, the state of every loop of the graph in its order; residuals (l,), its squared Mahalanobis distance from the
    poses, NaN where its sessions share no frame. covariances (n, 6, 6) of the poses of each session, of the tangent
    (x, y, z, rx, ry, rz) in the submap's frame, metres and radians, as of the first submap of the component, which is
    held fast; NaN where they are too large to be computed. chi2, the squared errors of all steps and of the loops in
    the map; degrees_of_freedom, what it is to be compared with.
    """

    T_map_submap: dict[str, Array64]
    components: tuple[tuple[str, ...], ...]
    loops: tuple[LoopState, ...]
    residuals: Array64
    covariances: dict[str, Array64]
    chi2: float
    degrees_of_freedom: int

    def T_map_odom(self, trajectory: Trajectory) -> se3.Matrix4:
        """The correction of a session: where its odometry frame lies in the map, as of its last submap."""
        return np.asarray(self.T_map_submap[trajectory.session][-1] @ se3.inverse(trajectory.T_odom_submap[-1]))


def optimise(
    graph: PoseGraph, robustness: Robustness = Robustness.COMMIT, told: Callable[[int, int], None] = lambda *_: None
) -> OptimisedGraph:
    """Place the sessions by the loops that agree, optimise each component, set loops aside that do not fit.

    Uncertainties that small circles show to be far too large are reduced before (see `variance_factor`), but for PLAIN
    and the other methods that are for comparison; covariances and distances in the answer rest on the reduced ones.
    `told` hears how many of how many components are done, and may raise to end the work.
    """
    if robustness in (Robustness.ONLINE, Robustness.COMMIT):
        graph = rescaled(graph, variance_factor(graph))
    sets, within = consistent_sets(graph), LoopsWithin.of(graph)
    components = [one.anchored(graph.anchors) for one in place_sessions(graph, sets)]
    trusted = Trusted.of(graph, sets, within)
    poses: dict[str, Array64] = {}
    covariances: dict[str, Array64] = {}
    chi2, degrees_of_freedom = 0.0, 0
    states = [LoopState.UNCONNECTED] * len(graph.loops)
    residuals = np.full(len(graph.loops), np.nan)
    for done, component in enumerate(components):
        told(done, len(components))
        problem = Problem.of(graph, component, trusted)
        solution, kept = _solve(problem, robustness)
        covariances.update(problem.covariances(solution, kept))
        chi2 += 2.0 * problem.graph(kept).error(solution)
        degrees_of_freedom += problem.degrees_of_freedom(kept)
        poses.update(poses_of(problem.trajectories, solution))
        for number, residual in zip(problem.loops, problem.residuals(solution), strict=True):
            residuals[number] = residual
            states[number] = LoopState.IN_MAP if number in kept else LoopState.SET_ASIDE
    groups = tuple(tuple(one.T_map_odom) for one in components)
    return OptimisedGraph(poses, groups, tuple(states), residuals, covariances, chi2, degrees_of_freedom)


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
        """What consistency between sessions and support within them say of the loops of the graph."""
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
    """A component as gtsam sees it: keys of nodes, factors of steps, one factor a loop, and a start.

    loops: numbers in the graph of the loops within the component; trusted: those of them that may be used.
    """

    trajectories: tuple[Trajectory, ...]
    keys: dict[Node, int]
    loops: tuple[int, ...]
    trusted: Trusted
    steps: gtsam.NonlinearFactorGraph
    loop_factors: dict[int, gtsam.NoiseModelFactor]
    loop_noises: dict[int, gtsam.noiseModel.Gaussian]
    edges: dict[int, LoopEdge]
    start: gtsam.Values

    @classmethod
    def of(cls, graph: PoseGraph, component: Component, trusted: Trusted) -> Problem:
        """The component's part of the graph, everything in canonical order: two runs are equal byte for byte."""
        trajectories = tuple(one for one in graph.trajectories if one.session in component.T_map_odom)
        nodes = [Node(one.session, ordinal) for one in trajectories for ordinal in range(len(one))]
        keys = {node: key for key, node in enumerate(nodes)}
        loops = {n: loop for n, loop in enumerate(graph.loops) if loop.match in keys and loop.query in keys}
        noises = {n: _noise(loop.covariance_in_query / loop.independent_share) for n, loop in loops.items()}
        factors = {n: _between(keys[loop.match], keys[loop.query], loop.T_match_query, noises[n])
                   for n, loop in loops.items()}  # fmt: skip
        return cls(
            trajectories, keys, tuple(loops), trusted.among(loops), _step_factors(trajectories, keys, component.anchor),
            factors, noises, loops, _start(trajectories, keys, component),
        )  # fmt: skip

    def graph(
        self, loops: Iterable[int], kernel: gtsam.noiseModel.mEstimator.Base | None = None
    ) -> gtsam.NonlinearFactorGraph:
        """The factors of the steps and of some loops, these under a robust kernel if one is given."""
        factors = gtsam.NonlinearFactorGraph(self.steps)
        for number in sorted(loops):
            if kernel is None:
                factors.add(self.loop_factors[number])
                continue
            noise = gtsam.noiseModel.Robust.Create(kernel, self.loop_noises[number])
            loop = self.edges[number]
            factors.add(_between(self.keys[loop.match], self.keys[loop.query], loop.T_match_query, noise))
        return factors

    def weighted(self, loops: Sequence[int], weights: Array64) -> gtsam.NonlinearFactorGraph:
        """The factors of the steps and of some loops, which weigh so much (l,), 0 to 1."""
        factors = gtsam.NonlinearFactorGraph(self.steps)
        for number, weight in zip(loops, weights, strict=True):
            if weight == 1.0:
                factors.add(self.loop_factors[number])
            elif weight > 0.0:
                factors.add(self.factor(self.edges[number], float(weight)))
        return factors

    def residuals(self, values: gtsam.Values) -> Array64:
        """Squared Mahalanobis distance of every loop of the component."""
        return np.array([2.0 * self.loop_factors[number].error(values) for number in self.loops])

    def factor(self, loop: LoopEdge, weight: float = 1.0) -> gtsam.NoiseModelFactor:
        """The factor of a loop between submaps of the component, which counts `weight` times."""
        ends = self.keys[loop.match], self.keys[loop.query]
        covariance = loop.covariance_in_query / (weight * loop.independent_share)
        return _between(*ends, loop.T_match_query, _noise(covariance))

    def degrees_of_freedom(self, kept: set[int]) -> int:
        """What the squared errors of the steps and the `kept` loops are to be compared with."""
        return 6 * (len(kept) - len(self.trajectories) + 1)

    def covariances(self, values: gtsam.Values, kept: set[int]) -> dict[str, Array64]:
        """The marginal covariances (n, 6, 6) of the poses of each session, translations first."""
        if (of_keys := marginal_covariances(self.graph(kept), values)) is None:
            return {one.session: np.full((len(one), 6, 6), np.nan) for one in self.trajectories}
        return {
            one.session: np.stack(
                [of_keys[self.keys[Node(one.session, place)]][_TRANSLATION_FIRST] for place in range(len(one))]
            )
            for one in self.trajectories
        }


def poses_of(trajectories: tuple[Trajectory, ...], values: gtsam.Values) -> dict[str, Array64]:
    """T_map_submap (n, 4, 4) of each session; the keys of the values count the submaps in order."""
    flat = gtsam.utilities.extractPose3(values)
    poses = np.tile(np.eye(4), (len(flat), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = flat[:, :9].reshape(-1, 3, 3), flat[:, 9:]
    ends = np.cumsum([len(one) for one in trajectories])
    return {one.session: part for one, part in zip(trajectories, np.split(poses, ends[:-1]), strict=True)}


def _solve(problem: Problem, robustness: Robustness) -> tuple[gtsam.Values, set[int]]:
    """The poses and the loops they rest on."""
    if robustness in (Robustness.PLAIN, Robustness.HUBER, Robustness.GNC):
        return _compared(problem, robustness)
    values, kept = _by_gates(problem)
    answers = [_regated(problem, values)]
    if robustness is Robustness.COMMIT and not _fits_throughout(problem, *answers[0]):
        answers.append(_regated(problem, _graduated(problem, set(problem.trusted.first | kept))))
    return min(answers, key=lambda answer: _cost(problem, *answer))


def _fits_throughout(problem: Problem, values: gtsam.Values, kept: set[int]) -> bool:
    """Whether no loop is set aside, and all errors together are no larger than the graph states them."""
    all_kept = len(kept) == len(problem.loops)
    return all_kept and _cost(problem, values, kept) <= problem.degrees_of_freedom(kept)


def _compared(problem: Problem, robustness: Robustness) -> tuple[gtsam.Values, set[int]]:
    """The methods that are for comparison, on all loops."""
    possible = set(problem.trusted.possible)
    if robustness is Robustness.PLAIN:
        return minimise(problem.graph(possible), problem.start), possible
    if robustness is Robustness.HUBER:
        kernel = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
        return minimise(problem.graph(possible, kernel), problem.start), possible
    values = _graduated(problem, possible)
    return values, _within(problem, values, possible, GATE)


def _cost(problem: Problem, values: gtsam.Values, kept: set[int]) -> float:
    """Squared errors of the steps and the kept loops; a loop that is set aside costs as much as the gate."""
    set_aside = len(problem.loops) - len(kept)
    return float(2.0 * problem.graph(kept).error(values) + GATE * set_aside)


def _by_gates(problem: Problem) -> tuple[gtsam.Values, set[int]]:
    """Cauchy weights first, under which wrong loops pull little; then the loops near those poses, exactly; then those
    that lie where these poses expect them, also loops that nothing supports.
    """
    first = set(problem.trusted.first)
    values, kept = _by_cauchy(problem, problem.start, first)
    if problem.trusted.speakers:
        values, kept = _with_spoken_for(problem, values, kept)
    usable = problem.trusted.with_spoken_for(first | problem.trusted.waiting)
    for _ in range(MAX_GATINGS):
        expected = _expected(problem, values, kept, usable - kept)
        if not expected:
            break
        values, kept = _gated(problem, values, usable, WIDE_GATE, kept | expected)
    return values, kept


def _with_spoken_for(problem: Problem, values: gtsam.Values, kept: set[int]) -> tuple[gtsam.Values, set[int]]:
    """The poses by the loops that the `kept` ones speak for, too; more speakers join where these expect them."""
    for _ in range(MAX_GATINGS):
        believed = kept | _expected(problem, values, kept, set(problem.trusted.first) - kept)
        heard = problem.trusted.with_spoken_for(believed)
        if heard <= kept:
            break
        before, (values, kept) = kept, _by_cauchy(problem, values, heard)
        if kept == before:
            break
    return values, kept


def _by_cauchy(problem: Problem, start: gtsam.Values, loops: set[int]) -> tuple[gtsam.Values, set[int]]:
    """The poses by some loops with Cauchy weights, then by those near these poses, exactly; and which those are."""
    values = minimise(problem.graph(loops, gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)), start, ROUGHLY)
    return _gated(problem, values, loops, WIDE_GATE)


def _gated(
    problem: Problem, values: gtsam.Values, usable: set[int], gate: float, kept: set[int] | None = None
) -> tuple[gtsam.Values, set[int]]:
    """The poses by the loops within a gate around them: loops return as the poses come nearer to them.

    `kept` are the loops to begin with, instead of those within the gate around `values`.
    """
    kept = _within(problem, values, usable, gate) if kept is None else kept
    for _ in range(MAX_GATINGS):
        values = minimise(problem.graph(kept), values)
        before, kept = kept, _within(problem, values, usable, gate)
        if kept == before:
            break
    return values, kept


def _expected(problem: Problem, values: gtsam.Values, kept: set[int], waiting: set[int]) -> set[int]:
    """The waiting loops within the gate around the poses; the uncertainty of the poses themselves is counted too where
    there are few. Where odometry allows many that do not fit, it is too unsure of itself to vouch for any.
    """
    near = _within(problem, values, waiting, GATE)
    if not waiting - near or len(waiting) > MAX_VOUCHED:
        return near
    if (marginals := _marginals(problem.graph(kept), values)) is None:
        return near
    return near | {n for n in sorted(waiting - near) if _distance(problem, values, marginals, n) < GATE}


def _marginals(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals | None:
    """The covariances at `values`; None where they are too large to be computed: long chains that nothing ties."""
    try:
        return gtsam.Marginals(factors, values)
    except RuntimeError:
        return None


def _distance(problem: Problem, values: gtsam.Values, marginals: gtsam.Marginals, number: int) -> float:
    """Squared Mahalanobis distance of a loop that is not among the factors from poses with their covariances."""
    first, second = (problem.keys[node] for node in (problem.edges[number].match, problem.edges[number].query))
    joint = marginals.jointMarginalCovariance(gtsam.KeyVector([first, second]))
    between = values.atPose3(first).between(values.atPose3(second))
    back = between.inverse().AdjointMap()
    of_first, of_second, both = joint.at(first, first), joint.at(second, second), joint.at(first, second)
    relative = back @ of_first @ back.T + of_second - back @ both - both.T @ back.T
    error = problem.loop_factors[number].unwhitenedError(values)
    covariance = relative + problem.loop_noises[number].covariance()
    return float(error @ np.linalg.solve(covariance, error))


def _regated(problem: Problem, values: gtsam.Values) -> tuple[gtsam.Values, set[int]]:
    """Whatever fits the poses by now is in the map, also loops that agreed with no others before."""
    kept = _within(problem, values, set(problem.loops), GATE)
    factors = problem.graph(kept)
    return settled(factors, minimise(factors, values)), kept


def _within(problem: Problem, values: gtsam.Values, usable: set[int], gate: float) -> set[int]:
    residuals = zip(problem.loops, problem.residuals(values), strict=True)
    return {number for number, residual in residuals if number in usable and residual < gate}


def _graduated(problem: Problem, usable: set[int]) -> gtsam.Values:
    """Graduated non-convexity on some loops: steps are known to be right."""
    numbers = sorted(usable)
    if not numbers:
        return problem.start
    factors = [problem.loop_factors[number] for number in numbers]
    return graduated(
        lambda weights: problem.weighted(numbers, weights),
        lambda values: np.array([factor.error(values) for factor in factors]),
        problem.start,
    )


def settled(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """The least cost itself, by Gauss-Newton steps from `values` near it: where it lies does not depend on the way
    there. `values` where no step can be computed.
    """
    for _ in range(MAX_SETTLING):
        try:
            step = factors.linearize(values).optimize()
        except RuntimeError:
            return values
        values = values.retract(step)
        if step.norm() < SETTLED_STEP:
            break
    return values


def _step_factors(
    trajectories: tuple[Trajectory, ...], keys: dict[Node, int], anchor_session: str
) -> gtsam.NonlinearFactorGraph:
    """The first submap of one session held fast, and every step of the odometry."""
    factors = gtsam.NonlinearFactorGraph()
    first = next(one for one in trajectories if one.session == anchor_session)
    anchor = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    factors.add(gtsam.PriorFactorPose3(keys[Node(first.session, 0)], gtsam.Pose3(first.T_odom_submap[0]), anchor))
    for one in trajectories:
        for ordinal, covariance in enumerate(one.step_covariances):
            T_step = se3.inverse(one.T_odom_submap[ordinal]) @ one.T_odom_submap[ordinal + 1]
            ends = keys[Node(one.session, ordinal)], keys[Node(one.session, ordinal + 1)]
            factors.add(_between(*ends, T_step, _noise(covariance)))
    return factors


def _start(trajectories: tuple[Trajectory, ...], keys: dict[Node, int], component: Component) -> gtsam.Values:
    values = gtsam.Values()
    for one in trajectories:
        for ordinal, T_odom_submap in enumerate(one.T_odom_submap):
            pose = gtsam.Pose3(component.T_map_odom[one.session] @ T_odom_submap)
            values.insert(keys[Node(one.session, ordinal)], pose)
    return values


def _between(
    first: int, second: int, T_first_second: se3.Matrix4, noise: gtsam.noiseModel.Base
) -> gtsam.NoiseModelFactor:
    return gtsam.BetweenFactorPose3(first, second, gtsam.Pose3(T_first_second), noise)


def _noise(covariance: Array64) -> gtsam.noiseModel.Gaussian:
    """A noise model for a covariance of (x, y, z, rx, ry, rz); gtsam has rotations first."""
    ordered = covariance[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)]
    return gtsam.noiseModel.Gaussian.Covariance(0.5 * (ordered + ordered.T))
