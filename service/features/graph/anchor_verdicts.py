"""The verdicts of a map's versions on anchors, packed into bytes, and the frames that these put on earth."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pose_graph.anchors import AnchorReason, AnchorState
from revisit.service.domain.records import MapVersionRecord
from revisit.service.features.graph.packed_rows import packed_rows
from revisit.service.ports.map_optimiser import GEOREFERENCES, JudgedTrackAnchor

Array64 = NDArray[np.float64]

_ANCHOR = np.dtype(
    [("number", "<i8"), ("state", "u1"), ("reason", "u1"), ("residual_m", "<f8", (3,)), ("squared_distance", "<f8")]
)
_STATES = tuple(AnchorState)
_REASONS = (None, *AnchorReason)


def pack_anchors(anchors: Sequence[JudgedTrackAnchor]) -> bytes | None:
    """The verdicts on anchors as bytes, None without any."""
    if not anchors:
        return None
    rows = np.empty(len(anchors), _ANCHOR)
    rows["number"] = [one.number for one in anchors]
    rows["state"] = [_STATES.index(one.verdict.state) for one in anchors]
    rows["reason"] = [_REASONS.index(one.verdict.reason) for one in anchors]
    rows["residual_m"] = [one.verdict.residual_m for one in anchors]
    rows["squared_distance"] = [one.verdict.squared_distance for one in anchors]
    return rows.tobytes()


def anchor_verdicts(data: bytes | None) -> dict[int, tuple[AnchorState, AnchorReason | None, Array64]]:
    """State, reason and residual (3,) of the anchors of a version, by number."""
    rows = _rows(data)
    return {
        int(row["number"]): (_STATES[row["state"]], _REASONS[row["reason"]], np.array(row["residual_m"]))
        for row in rows
    }


def changed_anchors(before: bytes | None, after: bytes | None) -> tuple[frozenset[int], frozenset[int]]:
    """The anchors, by number, that one of two versions sets aside and the other does not; and those that hold one of
    both alone.
    """
    here, there = (_rows(data) for data in (before, after))

    def of_one(state: AnchorState) -> frozenset[int]:
        one, other = (rows["number"][rows["state"] == _STATES.index(state)] for rows in (here, there))
        return frozenset(np.setxor1d(one, other).tolist())

    return of_one(AnchorState.SET_ASIDE), of_one(AnchorState.IN_MAP)


def kept_anchors(data: bytes | None, held: Collection[int]) -> bytes | None:
    """The verdicts on those anchors that are still there, by number."""
    rows = _rows(data)
    return rows[np.isin(rows["number"], list(held))].tobytes() or None


def frames_on_earth(summary: Mapping[str, Any]) -> dict[str, Matrix4]:
    """T_enu_map (4, 4) of the frames of a version that anchors hold, by name."""
    return {one["frame"]: pose_matrix(one["T_enu_map"]) for one in summary.get(GEOREFERENCES, ())}


def hash_of_anchors(record: MapVersionRecord) -> list[str]:
    """What the anchors of a version add to its hash: nothing without any."""
    if record.anchors is None:
        return []
    told = json.dumps(record.summary.get(GEOREFERENCES, []), sort_keys=True).encode()
    return [hashlib.sha256(record.anchors + told).hexdigest()]


def _rows(data: bytes | None) -> NDArray[Any]:
    """Raises DataLoss."""
    return packed_rows(data, _ANCHOR, state=len(_STATES), reason=len(_REASONS))
