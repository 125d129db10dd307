"""Clouds on their way to the service."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import RevisitError
from revisit.formats import NPY, QUANTISED, count_quantised, decode_cloud, encode_npy, encode_quantised

MAX_QUANTISED_M = 10_000.0


@dataclass(frozen=True)
class Cloud:
    """Points that are encoded already, for example a .pcd file with `application/vnd.pcd`."""

    data: bytes
    content_type: str


PointsLike: TypeAlias = "NDArray[np.floating[Any]] | Cloud"


def encoded(points: PointsLike) -> Cloud:
    """A cloud for the wire: (n, 3) metres or (n, 4) with intensity, quantised to 1 mm: a seventh to a quarter of
    the bytes.

    Clouds that cannot be quantised (non-finite numbers, beyond 10 km, negative intensity) go as npy, so that the
    service decides about it.
    """
    if isinstance(points, Cloud):
        return points
    array = np.asarray(points, dtype=np.float32)
    if _can_be_quantised(array):
        return Cloud(encode_quantised(array[:, :3], array[:, 3] if array.shape[1] == 4 else None), QUANTISED)
    if array.ndim != 2 or array.shape[1] not in (3, 4):
        raise ValueError(f"points must be (n, 3) or (n, 4), got {array.shape}")
    return Cloud(encode_npy(array[:, :3], array[:, 3] if array.shape[1] == 4 else None), NPY)


def count_returns(points: PointsLike) -> int:
    """How many finite points a scan has, as the service counts; 0 of a cloud that cannot be read.

    Asked for each scan, sent or not: a cloud in the form of the wire is not decoded.
    """
    if not isinstance(points, Cloud):
        array = np.asarray(points)
        with np.errstate(over="ignore", invalid="ignore"):
            # A sum of all numbers tells that none is infinite or NaN, in a sixth of the time of that of some columns.
            if array.ndim != 2 or np.isfinite(array.sum()) or np.isfinite(array[:, :3].sum()):
                return len(array)
        return int(np.isfinite(array[:, :3]).all(axis=1).sum())
    try:
        if points.content_type == QUANTISED:
            return count_quantised(points.data)
        return count_returns(decode_cloud(points.data, points.content_type).points)
    except RevisitError:
        return 0


def _can_be_quantised(array: NDArray[np.float32]) -> bool:
    if array.ndim != 2 or array.shape[1] not in (3, 4) or not np.isfinite(array).all():
        return False
    within = bool(np.abs(array[:, :3]).max(initial=0.0) <= MAX_QUANTISED_M)
    return within and (array.shape[1] == 3 or bool((array[:, 3] >= 0).all()))
