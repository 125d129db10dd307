"""The head of a stored place (docs/decisions/0287): what it says of itself, and its frame, in about 60 bytes."""

from __future__ import annotations

import dataclasses
import math
import re
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadTransform, DataLoss
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.scan_disagreement import ScanDisagreement

_HEAD = struct.Struct("<BdIBII")  # flags, spacing, keypoints, numbers of a descriptor, bytes of two sections
_MODEL_IN_HEX, _DISAGREEMENT, _IN_PARTS, _TRANSLATION, _SCALE = 1, 2, 4, 8, 16
_LARGEST = 5  # two bits from this on: which component of the quaternion is left out
_EVERY_FLAG = 127
_HEX = re.compile("[0-9a-f]{16}")
_PART = 1e5
"""Parts of a unit in which the scans' disagreement is rounded when it is measured."""
_UNIT = float(1 << 46)
"""Parts of 1 of a component of a quaternion: 1.4e-14."""
_COMPONENT_BYTES = 6
_LARGE_ENOUGH = 0.499  # one of four whose squares sum to 1 is


@dataclass(frozen=True)
class PlaceHead:
    """`spacing`, `model`, `frame` and `scan_disagreement` as of `core.place.Place`; of the arrays how many `keypoints`,
    numbers of a descriptor, and how many bytes of the keypoints and of the standing surface.
    """

    spacing: float
    model: str
    frame: LevelFrame
    scan_disagreement: ScanDisagreement | None
    keypoints: int = 0
    numbers: int = 0
    keypoint_bytes: int = 0
    standing_bytes: int = 0


def pack_head(head: PlaceHead) -> bytes:
    """The head as bytes. Raises ValueError for a model's name of more than 255 bytes in UTF-8."""
    quaternion, largest = _short_quaternion(head.frame)
    flags, model = (_MODEL_IN_HEX, bytes.fromhex(head.model)) if _HEX.fullmatch(head.model) else (0, _named(head.model))
    flags |= largest << _LARGEST
    parts = [model, quaternion]
    if np.any(head.frame.translation != 0.0):
        flags |= _TRANSLATION
        parts.append(struct.pack("<3d", *head.frame.translation))
    if head.frame.scale != 1.0:
        flags |= _SCALE
        parts.append(struct.pack("<d", head.frame.scale))
    if head.scan_disagreement is not None:
        values = dataclasses.astuple(head.scan_disagreement)
        rounded = [round(value * _PART) for value in values]
        short = all(n <= 0xFFFF and n / _PART == value for n, value in zip(rounded, values, strict=True))
        flags |= _DISAGREEMENT | (_IN_PARTS if short else 0)
        parts.append(struct.pack("<4H", *rounded) if short else struct.pack("<4d", *values))
    sizes = head.spacing, head.keypoints, head.numbers, head.keypoint_bytes, head.standing_bytes
    return _HEAD.pack(flags, *sizes) + b"".join(parts)


def unpack_head(content: bytes) -> tuple[PlaceHead, int]:
    """The head that `content` begins with, and its length. Raises DataLoss for what `pack_head` did not write."""
    string = _Bytes(content)
    flags, spacing, *counts = string.unpacked(_HEAD.format)
    if flags > _EVERY_FLAG or (flags & _IN_PARTS and not flags & _DISAGREEMENT):
        raise DataLoss("the head of the place is unusable")
    model = string.taken(8).hex() if flags & _MODEL_IN_HEX else _name(string)
    rotation = _rotation(string.taken(3 * _COMPONENT_BYTES), flags >> _LARGEST)
    translation = np.array(string.unpacked("<3d") if flags & _TRANSLATION else (0.0, 0.0, 0.0))
    (scale,) = string.unpacked("<d") if flags & _SCALE else (1.0,)
    disagreement = _disagreement(string, bool(flags & _IN_PARTS)) if flags & _DISAGREEMENT else None
    if not (1e-6 < scale < 1e6 and np.abs(translation).max() <= se3.MAX_TRANSLATION_M):
        raise DataLoss("the level frame of the place is no similarity")
    frame = LevelFrame(rotation, translation, scale)
    return PlaceHead(checked_spacing(spacing), model, frame, disagreement, *counts), string.position


def checked_spacing(spacing: object) -> float:
    """The edge of the cubes of which a surface keeps a standing point each. Raises DataLoss for no such length."""
    if type(spacing) is not float or not 1e-3 <= spacing <= 1e3:
        raise DataLoss("the place's spacing is unusable")
    return spacing


class _Bytes:
    """Bytes that are read from the first on. All raise DataLoss behind the end."""

    def __init__(self, content: bytes) -> None:
        self._content, self.position = content, 0

    def taken(self, count: int) -> bytes:
        found = self._content[self.position : self.position + count]
        if len(found) != count:
            raise DataLoss("the place is cut short")
        self.position += count
        return found

    def unpacked(self, form: str) -> tuple[Any, ...]:
        return struct.unpack(form, self.taken(struct.calcsize(form)))


def _named(model: str) -> bytes:
    name = model.encode()
    if len(name) > 255:
        raise ValueError("the name of the place's model is too long")
    return bytes([len(name)]) + name


def _name(string: _Bytes) -> str:
    try:
        return string.taken(string.taken(1)[0]).decode()
    except UnicodeDecodeError as error:
        raise DataLoss("the place names no model") from error


def _short_quaternion(frame: LevelFrame) -> tuple[bytes, int]:
    """Three components of the rotation's quaternion, and which one is left out: the first that is no small number."""
    quaternion = se3.to_quaternion(frame.T_submap_upright)
    largest = int(np.argmax(np.abs(quaternion) > _LARGE_ENOUGH))
    others = np.delete(quaternion, largest) * np.copysign(1.0, quaternion[largest])
    parts = (int(part).to_bytes(_COMPONENT_BYTES, "little", signed=True) for part in np.rint(others * _UNIT))
    return b"".join(parts), largest


def _rotation(data: bytes, largest: int) -> NDArray[np.float64]:
    """The rotation (3, 3) of what `_short_quaternion` wrote."""
    width = _COMPONENT_BYTES
    parts = [int.from_bytes(data[at : at + width], "little", signed=True) for at in range(0, len(data), width)]
    others = [part / _UNIT for part in parts]
    left = 1.0 - math.fsum(other * other for other in others)
    if left <= 0.0:
        raise DataLoss("the level frame of the place is no similarity")
    try:
        return se3.from_quaternion([*others[:largest], math.sqrt(left), *others[largest:]], np.zeros(3))[:3, :3].copy()
    except BadTransform as error:
        raise DataLoss("the level frame of the place is no similarity") from error


def _disagreement(string: _Bytes, in_parts: bool) -> ScanDisagreement:
    values = [part / _PART for part in string.unpacked("<4H")] if in_parts else string.unpacked("<4d")
    if not all(0.0 <= value < math.inf for value in values):
        raise DataLoss("the disagreement of the place's scans is no lengths and angles")
    return ScanDisagreement(*values)
