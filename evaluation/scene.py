"""How large the scene of a recording is: rooms are not streets (docs/decisions/0009)."""

from __future__ import annotations

import numpy as np

from evaluation.datasets import Recording

STREET_RANGE_M = 20.0
SMALLEST_STREET_RANGE_M = 10.0
SMALLEST_SCALE = 0.15
SAMPLED_SCANS = 20


def estimate_scene_scale(recording: Recording) -> float:
    """The scene scale for a recording: 1 unless 90 % of the returns are nearer than 10 m.

    Below, that range over 20 m, what it is on streets; at least 0.15. Every recording of streets, yards or parks is
    described with the same scale, so that its descriptors stay comparable with others.
    """
    chosen = range(0, len(recording), max(1, len(recording) // SAMPLED_SCANS))
    reach = float(np.median([np.percentile(np.linalg.norm(recording.scan(i).points, axis=1), 90) for i in chosen]))
    return 1.0 if reach >= SMALLEST_STREET_RANGE_M else max(SMALLEST_SCALE, reach / STREET_RANGE_M)
