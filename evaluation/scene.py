"""How large the scene of a recording is: rooms are not streets (docs/decisions/0009)."""

from __future__ import annotations

import numpy as np

from revisit.core.errors import RevisitError
from revisit.evaluation.datasets import Recording

STREET_RANGE_M = 20.0
SMALLEST_STREET_RANGE_M = 10.0
SMALLEST_SCALE = 0.15
SAMPLED_SCANS = 20


def estimate_scene_scale(recording: Recording) -> float:
    """The scene scale for a recording: 1 unless 90 % of the returns are nearer than 10 m.

    Below, that range over 20 m, its value on streets; at least 0.15. Every recording of streets, yards or parks is
    described with the same scale, so that its descriptors stay comparable with others. Scans that cannot be read say
    nothing; without any other, 1.
    """
    chosen = range(0, len(recording), max(1, len(recording) // SAMPLED_SCANS))
    reaches = [reach for index in chosen if (reach := _reach_m(recording, index)) is not None]
    if not reaches:
        return 1.0
    reach = float(np.median(reaches))
    return 1.0 if reach >= SMALLEST_STREET_RANGE_M else max(SMALLEST_SCALE, reach / STREET_RANGE_M)


def _reach_m(recording: Recording, index: int) -> float | None:
    """The range in metres within which 90 % of a scan's returns lie, None where it cannot be read."""
    try:
        points = recording.scan(index).points
    except (RevisitError, OSError):
        return None
    return float(np.percentile(np.linalg.norm(points, axis=1), 90))
