"""How many points a scan and a submap may have: at the limit and one above."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.errors import TooLarge
from revisit.formats import DecodedCloud
from revisit.service.domain.limits import SCAN_POINTS, SUBMAP_POINTS
from revisit.service.features.ingest.clouds import accept_cloud


def test_the_limits_are_those_of_the_documentation():
    assert (SCAN_POINTS, SUBMAP_POINTS) == (500_000, 2_000_000)


@pytest.mark.parametrize("limit", [SCAN_POINTS, SUBMAP_POINTS], ids=["scan", "submap"])
def test_a_cloud_may_have_as_many_points_as_the_limit_and_no_more(limit):
    points = np.random.default_rng(1).uniform(-50, 50, (limit + 1, 3)).astype(np.float32)
    accepted, _ = accept_cloud(DecodedCloud(points[:limit]), limit)
    assert len(accepted.points) == limit
    with pytest.raises(TooLarge, match=f"may hold {limit} points here, got {limit + 1}"):
        accept_cloud(DecodedCloud(points), limit)
