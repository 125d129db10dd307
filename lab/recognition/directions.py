"""In which direction a place is passed again: the same as before, the opposite, or across."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from lab.recognition.experiment import Experiment, MethodResult
from revisit.evaluation.metrics import Floats


class Direction(StrEnum):
    """How a query passes the nearest submap of its place: within 45 degrees of its course, of the opposite, or else."""

    SAME = "same"
    REVERSE = "reverse"
    ACROSS = "across"


def directions(experiment: Experiment) -> NDArray[np.object_]:
    """The Direction of every query (q,); None for a query without a loop."""
    queries, known = (np.array(one).reshape(-1, 3) for one in (experiment.query_positions, experiment.map_positions))
    query_courses, known_courses = courses(queries), courses(known)
    positives = experiment.ground_truth().positives
    found = np.full(len(queries), None, dtype=object)
    for query in np.flatnonzero(positives.any(axis=1)):
        distance = np.linalg.norm(known - queries[query], axis=1)
        nearest = np.where(positives[query], distance, np.inf).argmin()
        cosine = float(query_courses[query] @ known_courses[nearest])
        along = Direction.SAME if cosine > 0 else Direction.REVERSE
        found[query] = along if abs(cosine) > np.cos(np.pi / 4) else Direction.ACROSS
    return found


def courses(positions: Floats) -> Floats:
    """Unit vectors (n, 3) of the way on which positions (n, 3), in order of time, were passed; zeros where it stood."""
    if len(positions) < 2:
        return np.zeros_like(positions)
    step = np.gradient(positions, axis=0)
    return np.asarray(step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))


def recall_by_direction(experiment: Experiment, result: MethodResult) -> dict[Direction, tuple[int, int]]:
    """Of the queries passing in each direction: how many have a right first candidate, and how many there are."""
    positives, found = experiment.ground_truth().positives, {}
    passed = directions(experiment)
    right = np.array([bool(ids) and bool(positives[query, ids[0]]) for query, ids in enumerate(result.candidates)])
    for direction in Direction:
        chosen = np.array([one == direction for one in passed], dtype=bool)
        found[direction] = int(right[chosen].sum()), int(chosen.sum())
    return found
