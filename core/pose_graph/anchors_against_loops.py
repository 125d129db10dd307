"""Loops that anchors speak against: two places that look alike, and lie far apart on earth.

Where places are exact twins, geometry cannot tell them apart; a fix on earth can. A loop says how far apart the anchors
beside its two submaps must lie; it is refuted where they lie farther apart, by more than receivers err
(docs/decisions/0357).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import LEAST_BESIDE, LEAST_SHARE, SIGMAS, AnchoredDrive, anchored_drives
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import LoopEdge, Node

Array64 = NDArray[np.float64]

TOGETHER_M = 20.0
"""An anchor is compared with the one of the other drive that a loop puts nearest to it, if so near."""

FAR_M = 100.0
"""No receiver errs by so much more than it states, and few datums lie so far apart."""

APART_M, NEAR_M, LEAST_NEAR = 45.0, 25.0, 3
"""Between drives whose anchors lie within NEAR_M of each other by so many loops, receivers agree, as one does with
itself. There reflections alone make a difference, and hardly one is of more than APART_M beyond what is stated."""

ANOTHER_SITE_M = 100_000.0
"""A place so far away is none: receivers tell (0, 0) before they have a fix."""


def refuted_by_anchors(
    T_odom_submap: Mapping[str, Array64], loops: Sequence[LoopEdge], anchors: Sequence[Anchor]
) -> set[str]:
    """The names of the loops that anchors speak against. T_odom_submap (n, 4, 4): the drive of each session.

    Nothing but the loop, its drives and their anchors counts; of all loops between two drives it counts how many their
    anchors agree with.
    """
    drives = anchored_drives(T_odom_submap, anchors)
    excess = {
        loop.name: _excess_m(drives[loop.match.session], drives[loop.query.session], loop)
        for loop in loops
        if loop.match.session in drives and loop.query.session in drives
    }
    pairs = {loop.name: frozenset((loop.match.session, loop.query.session)) for loop in loops}
    near: dict[frozenset[str], set[Node]] = {}
    for loop in loops:
        if _most(excess.get(loop.name), below=NEAR_M):
            near.setdefault(pairs[loop.name], set()).add(loop.query)
    agree = {pair for pair, queries in near.items() if len(queries) >= LEAST_NEAR}
    return {
        name
        for name, its in excess.items()
        if _most(its, above=APART_M if len(pairs[name]) == 1 or pairs[name] in agree else FAR_M)
        and all(drives[one].fits for one in pairs[name])
    }


def _excess_m(match: AnchoredDrive, query: AnchoredDrive, loop: LoopEdge) -> Array64 | None:
    """How much farther apart anchors (n,) of two drives lie than a loop says, less what their errors explain.

    Each with the nearest of the other drive; None where too few lie beside it.
    """
    points, places, sigmas = match.beside(loop.match.ordinal)
    others, other_places, other_sigmas = query.beside(loop.query.ordinal)
    if min(len(points), len(others)) < LEAST_BESIDE:
        return None
    told_m = np.linalg.norm(points[:, None] - se3.apply(loop.T_match_query, others)[None], axis=2)
    rows = np.concatenate([np.arange(len(points)), told_m.argmin(axis=0)])
    columns = np.concatenate([told_m.argmin(axis=1), np.arange(len(others))])
    apart_m = np.linalg.norm(places[rows] - other_places[columns], axis=1)
    compared = (told_m[rows, columns] <= TOGETHER_M) & (apart_m < ANOTHER_SITE_M)
    if min(len({*rows[compared]}), len({*columns[compared]})) < LEAST_BESIDE:
        return None
    errors_m = SIGMAS * np.hypot(sigmas[rows], other_sigmas[columns])
    return np.asarray((apart_m - told_m[rows, columns] - errors_m)[compared])


def _most(excess_m: Array64 | None, above: float = -np.inf, below: float = np.inf) -> bool:
    """Whether most anchors lie within these bounds; none say nothing."""
    return excess_m is not None and bool(((excess_m > above) & (excess_m < below)).mean() >= LEAST_SHARE)
