"""BoW3D as a baseline: it needs single scans and their lines, which a submap has not."""

from __future__ import annotations

import dataclasses
import heapq
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lab.baselines import bow3d
from lab.baselines.bow3d import Bow3d
from lab.baselines.link3d import LinkFeatures
from lab.recognition.comparison import KEPT_CANDIDATES
from lab.recognition.experiment import Experiment
from lab.recognition.sequential_baseline import Verification, answers_of, matches_of
from revisit.core.errors import RevisitError
from revisit.evaluation.cutting import Window
from revisit.evaluation.datasets import Recording

SCANS = 3
SEVERAL_NAME = f"{bow3d.NAME}, {SCANS} scans"
_A_VOTE = 1e-3

Scans = dict[int, list[LinkFeatures]]
"""The features of the scans of each submap, by its number."""


def with_bow3d(
    experiment: Experiment,
    recording: Recording,
    elevations_deg: Sequence[float],
    verification: Verification | None = None,
    candidates: int = KEPT_CANDIDATES,
    method: Bow3d = Bow3d(),
) -> Experiment:
    """The experiment on one drive (protocol online) with the results of BoW3D beside the others.

    `elevations_deg` (b,) of the sensor's beams. Its places are single scans: the middle one of each submap, and then
    `SCANS` evenly chosen ones of each. A submap asks with the same scans of its own; the best pair counts. With a
    `verification` its first `candidates` are verified as well. Raises ValueError for an experiment between two
    recordings.
    """
    if not experiment.within_session:
        raise ValueError("BoW3D is asked about one drive, in its order")
    truth, results = experiment.ground_truth(), list(experiment.results)
    for name, count in ((bow3d.NAME, 1), (SEVERAL_NAME, SCANS)):
        chosen = [_chosen(window, count) for window in experiment.query_windows]
        started = time.process_time()
        found = find_submaps(features_of(recording, chosen, elevations_deg, method), truth.allowed, method)
        seconds = (time.process_time() - started) / max(len(found), 1)
        results += answers_of(matches_of(found, truth, max(candidates, KEPT_CANDIDATES)), seconds, name, verification)
    return dataclasses.replace(experiment, results=tuple(results))


def _chosen(window: Window, count: int) -> Window:
    """So many scans of a submap, evenly chosen: the middle one where it is one."""
    rows = sorted({(2 * part + 1) * len(window) // (2 * count) for part in range(count)})
    return tuple(window[row] for row in rows)


def features_of(
    recording: Recording, windows: Sequence[Window], elevations_deg: Sequence[float], method: Bow3d
) -> Scans:
    """The features of the scans of each submap; a bad scan is left out."""
    found: Scans = {}
    for number, window in enumerate(windows):
        found[number] = []
        for index in window:
            try:
                points = recording.scan(index).points
            except (RevisitError, OSError):
                continue
            found[number].append(method.link.features(points, elevations_deg))
    return found


def find_submaps(scans: Scans, allowed: NDArray[np.bool_], method: Bow3d) -> list[dict[int, float]]:
    """For each submap the `allowed` ones (q, q) that share words with it, by number.

    The value is how many matched edges of their best two scans agree on one pose; where none do, a thousandth of their
    votes.
    """
    features = [one for each in scans.values() for one in each]
    owner = [number for number, each in scans.items() for _ in each]
    words, found = method.words(features), list[dict[int, float]]()
    for number, own in scans.items():
        known, submaps = words.of(allowed[number, owner]), dict[int, float]()
        votes = {(q, scan): count for q, one in enumerate(own) for scan, count in method.votes(one, known).items()}
        for q, scan in heapq.nlargest(method.candidates * len(own), votes, key=lambda pair: (votes[pair], pair)):
            agreeing = method.agreeing(own[q], features[scan])[0]
            submaps[owner[scan]] = max(submaps.get(owner[scan], 0.0), agreeing, _A_VOTE * votes[q, scan])
        found.append(submaps)
    return found
