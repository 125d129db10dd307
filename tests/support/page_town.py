"""The town that tests of the page look at: two sessions, eight submaps, five accepted loop closures."""

from __future__ import annotations

import numpy as np

from revisit.core.config import PipelineConfig, VerificationConfig
from tests.support.service_world import cloud_points, pose

PLACES = {"monday": (1, 30, 60, 90, 1), "tuesday": (30, 1, 60)}

EACH_BY_ITSELF = PipelineConfig(verification=VerificationConfig(support_reach=0.01, rival_distance=50.0))
"""The fake puts every pair 1 m apart, whatever odometry says of it: no loop is held against those beside it."""


def fill(client, town="town", named="{initial}{index}"):
    """Make the map `town`, with submaps that are `named` so."""
    client.create_map(town, display_name="The town")
    for number, (name, places) in enumerate(PLACES.items()):
        session = client.create_session(f"maps/{town}", name)
        for index, place in enumerate(places):
            T_odom_submap = pose(12.0 * index)
            T_odom_submap[1, 3] = 8.0 * np.sin(index) + 3.0 * number
            submap_id = named.format(initial=name[0], index=index)
            client.wait(client.post_submap(session, submap_id, cloud_points(place), T_odom_submap, 1_000 + index))
