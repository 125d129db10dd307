"""Places with keypoints, for services whose recogniser describes none that can be read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.place import Place
from revisit.service.domain.identity import DEFAULT_TENANT
from revisit.service.ports.blobs import PLACE_BLOB

SCALE = 0.5
T_SUBMAP_LEVEL = se3.exp([0.4, -0.2, 1.1, 0.05, -0.03, 0.0])


def a_place(keypoints: np.ndarray, model: str = "patches-1") -> Place:
    """A place with these keypoints (n, 2), at most 16, in metres of an upright frame that is tilted and moved.

    The n-th keypoint of one looks like the n-th of another.
    """
    count = len(keypoints)
    frame = LevelFrame.from_upright(T_SUBMAP_LEVEL, SCALE)
    corner = np.zeros((1, 3), dtype=np.float32)
    return Place(
        (keypoints / SCALE).astype(np.float32), np.full(count, 1.0, np.float32), np.eye(count, 16, dtype=np.float32),
        np.ones(16, np.float32), corner, corner + np.float32([0, 0, 1]), 1, model, frame,
    )  # fmt: skip


def in_place_of(service, submap: str, place: Place) -> None:
    """Give a submap this place, whatever it was described with."""
    _, map_id, _, session_id, _, submap_id = submap.split("/")
    context = service.world.context
    sha256 = context.storage.blobs.put(DEFAULT_TENANT, PLACE_BLOB, place.to_blob())

    def change(uow):
        described = uow.submaps.get(DEFAULT_TENANT, map_id, session_id, submap_id)
        uow.submaps.replace(replace(described, place_sha256=sha256))

    context.transactions.write(change).result()


def places_of(service, loop, count: int, elsewhere: int) -> np.ndarray:
    """Give both submaps of a loop places whose keypoints its pose joins, but for the last `elsewhere` of `count`.

    The keypoints (n, 2) of the query, in the order in which places keep them: by y.
    """
    of_query = np.column_stack([np.random.default_rng(5).uniform(-20, 20, count), np.linspace(-20, 20, count)])
    # The pose is one of the submaps' frames: seen in the tilted frames of the plans it is nearly the same.
    T_level = se3.inverse(T_SUBMAP_LEVEL) @ loop.T_match_query @ T_SUBMAP_LEVEL
    of_match = of_query + T_level[:2, 3]
    of_match[count - elsewhere :] += (0.0, 9.0)
    in_place_of(service, loop.query, a_place(of_query))
    in_place_of(service, loop.match, a_place(of_match))
    return of_query
