"""The covariances of all poses of a solved graph, from one elimination (docs/decisions/0270)."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

_POSE = 6


@dataclass(frozen=True)
class _Eliminated:
    """A pose as it was eliminated: how it depends on the `parents`, poses that were eliminated later.

    gain (6, 6p): what its error is made of theirs; own (6, 6): the covariance of what is left.
    """

    parents: tuple[int, ...]
    gain: Array64
    own: Array64


@dataclass
class _Front:
    """The covariance (6m, 6m) of poses together, by the rows they begin at; `waiting`: how many others need it yet."""

    rows: dict[int, int]
    covariance: Array64
    waiting: int

    def of(self, keys: tuple[int, ...]) -> Array64:
        """The covariance (6k, 6k) of some of its poses."""
        begins = np.array([self.rows[key] for key in keys], dtype=np.int64)
        index = (begins[:, None] + np.arange(_POSE)).ravel()
        return np.asarray(self.covariance[np.ix_(index, index)])


def marginal_covariances(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> dict[int, Array64] | None:
    """The covariance (6, 6) of each pose of `values`, by key, of its tangent as gtsam has it: rotation first.

    None where they are too large to be computed: long chains that nothing ties. Those of all poses together fill a
    square, of which only what is needed is made: the parents of a pose are among the one eliminated first of them and
    its own parents, whose covariance is known when it is asked for and let go of when nothing asks for it any more.
    """
    try:
        eliminated = _eliminated(factors.linearize(values).eliminateSequential())
    except (RuntimeError, np.linalg.LinAlgError):
        return None
    order = {key: place for place, key in enumerate(eliminated)}
    children: dict[int | None, list[int]] = {}
    for key, one in eliminated.items():
        children.setdefault(min(one.parents, key=order.__getitem__, default=None), []).append(key)
    fronts, found = dict[int, _Front](), dict[int, Array64]()
    todo: list[tuple[int, int | None]] = [(key, None) for key in children.get(None, ())]
    while todo:
        key, parent = todo.pop()
        front = _front(key, eliminated[key], None if parent is None else fronts[parent], len(children.get(key, ())))
        found[key] = front.covariance[:_POSE, :_POSE].copy()
        if parent is not None:
            fronts[parent].waiting -= 1
            if fronts[parent].waiting == 0:
                del fronts[parent]
        if front.waiting:
            fronts[key] = front
            todo += [(child, key) for child in children[key]]
    return found


def _front(key: int, one: _Eliminated, parent: _Front | None, waiting: int) -> _Front:
    """The covariance of a pose and its parents together."""
    if parent is None:
        return _Front({key: 0}, one.own, waiting)
    of_parents = parent.of(one.parents)
    across = one.gain @ of_parents
    own = one.own + across @ one.gain.T
    rows = {name: _POSE * place for place, name in enumerate((key, *one.parents))}
    return _Front(rows, np.block([[own, across], [across.T, of_parents]]) if waiting else own, waiting)


def _eliminated(net: gtsam.GaussianBayesNet) -> dict[int, _Eliminated]:
    """The poses by key, in the order in which they were eliminated."""
    found = {}
    for place in range(net.size()):
        conditional = net.at(place)
        key, *parents = conditional.keys()
        root = np.linalg.inv(conditional.R())
        found[key] = _Eliminated(tuple(parents), -root @ conditional.S(), root @ root.T)
    return found
