"""The evidence of a measured loop in a quarter of its JSON: what it measured is kept to the bit.

The covariance and the pose are whole numbers of eight bytes; everything else is JSON, deflated with the words that
evidence is made of.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORM = b"\x03"
"""The first byte."""

_SYMMETRIC, _POSED = 1, 2
"""Of the byte behind it: how the covariance is written, and whether a pose follows."""

_LOWER, _ABOVE = np.tril_indices(6), np.tril_indices(6, -1)
_OF_FACTOR, _OF_STEPS, _WHOLE = 21 * 8, 15, 36 * 8
_RIGID = (0.0, 0.0, 0.0, 1.0)
_ROWS = struct.Struct("<12d")

_WORDS = (
    b'{"waits_until_m":null,"neighbours":null,"reason":"support":{"anchors":,"agreeing":,"along_m":,"ruled_out":[['
    b'"doubts":{"PAIRWISE_INCONSISTENT":{"words":"ODOMETRY_INCONSISTENT":{"words":"PERCEPTUAL_ALIAS":{"words":'
    b'"BETTER_ALTERNATIVE":{"words":"LOW_CONSISTENT_SHARE":{"words":"SUPPORT_LOST":{"words":"recall":{'
    b'{"overlap":0.,"T_match_query":[[0.9999,-0.00,0.0],[0.0,0.0,0.0,1.0]]},'
    b'{"measurement":{"similarity":0.0,"inliers":1,"inlier_ratio":0.0,"overlap":0.3,"contrast":0.1,"seen_through":0.0,'
    b'"rmse_m":0.10,"score":0.99,"T_match_query":0,"covariance":0,"rivals":[],"common_share":0.5,"enough_share":0.35},'
    b'"thresholds":{"max_seen_through":0.35,"min_overlap":0.2,"min_score":0.5},"thresholds_version":"f8d7b366232e",'
    b'"distinctiveness":{"compared":1,"passing":1,"other_spots":0},"model_version":"revisit-c770bc1eb8cd"}'
)
"""What deflating may point back to. It is part of the form: other words are another form."""


_LITTLE_MEMORY = 4
"""Of deflating: what it takes to be allocated is half of the time."""


def packed(evidence: dict[str, Any]) -> bytes | None:
    """Evidence with a measured covariance as bytes; None for any other, which stays JSON."""
    try:
        covariance = np.array(evidence["measurement"]["covariance"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        return None
    pose = _rows_of(evidence["measurement"].get("T_match_query"))
    measured = {**evidence["measurement"], "covariance": 0} | ({} if pose is None else {"T_match_query": 0})
    rest = json.dumps({**evidence, "measurement": measured}, separators=(",", ":"), ensure_ascii=False).encode()
    symmetric, numbers = _covariance_bytes(covariance)
    form = bytes([symmetric * _SYMMETRIC | (pose is not None) * _POSED])
    data = FORM + form + numbers + (pose or b"") + _deflated(rest)
    return data if unpacked(data) == evidence else None


def unpacked(data: bytes) -> dict[str, Any]:
    """The inverse of `packed`."""
    form, at = data[1], 2 + _covariance_size(data[1])
    covariance = covariance_of(data)
    pose = _ROWS.unpack_from(data, at) if form & _POSED else None
    inflater = zlib.decompressobj(-zlib.MAX_WBITS, _WORDS)
    evidence: dict[str, Any] = json.loads(inflater.decompress(data[at + (_ROWS.size if pose else 0) :]))
    evidence["measurement"]["covariance"] = covariance
    if pose is not None:
        rows = [list(pose[start : start + 4]) for start in (0, 4, 8)]
        evidence["measurement"]["T_match_query"] = [*rows, list(_RIGID)]
    return evidence


def covariance_of(data: bytes) -> list[list[float]]:
    """The covariance (6, 6) alone, without inflating anything."""
    if not data[1] & _SYMMETRIC:
        whole: list[list[float]] = np.frombuffer(data, "<f8", 36, 2).reshape(6, 6).tolist()
        return whole
    bits: NDArray[np.int64] = np.zeros((6, 6), np.int64)
    bits[_LOWER] = np.frombuffer(data, "<i8", 21, 2)
    steps = np.frombuffer(data, np.int8, _OF_STEPS, 2 + _OF_FACTOR)
    bits.T[_ABOVE] = bits[_ABOVE] + steps
    covariance: list[list[float]] = bits.view(np.float64).tolist()
    return covariance


def _covariance_size(form: int) -> int:
    return _OF_FACTOR + _OF_STEPS if form & _SYMMETRIC else _WHOLE


def _covariance_bytes(covariance: NDArray[np.float64]) -> tuple[bool, bytes]:
    """Whether it is symmetric but for last bits, and its bytes: then half of it, and how many steps the rest is off."""
    bits = covariance.view(np.int64)
    with np.errstate(over="ignore"):
        steps = bits.T[_ABOVE] - bits[_ABOVE]
    if (np.abs(steps) > np.iinfo(np.int8).max).any():
        return False, covariance.astype("<f8").tobytes()
    return True, bits[_LOWER].astype("<i8").tobytes() + steps.astype(np.int8).tobytes()


def _rows_of(pose: Any) -> bytes | None:
    """The first three rows of a rigid transform (4, 4); None of anything else."""
    try:
        rows = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    if rows.shape != (4, 4) or not np.isfinite(rows).all() or tuple(rows[3]) != _RIGID:
        return None
    return _ROWS.pack(*rows[:3].ravel().tolist())


def _deflated(data: bytes) -> bytes:
    deflater = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS, _LITTLE_MEMORY, zlib.Z_DEFAULT_STRATEGY, _WORDS)
    return deflater.compress(data) + deflater.flush()
