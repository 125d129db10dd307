"""Neural points that were read or written lately, in a form that is unpacked in a hundredth of the time of reading."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.codec.neural_points import Codes, Form, PlaneCodes, read_points

_VOXEL, _PLANE = np.dtype("<u2"), np.dtype("i1")
_LEVEL = 1


class KnownPoints:
    """Points by their stream, those that were used last: what is unpacked is what was read, to a bit.

    Points without features alone: those of learned maps are read each time. Any thread may ask.
    """

    def __init__(self, most_bytes: int) -> None:
        """At most so many are kept: a submap of 20,000 points takes 60 kB."""
        self._most = most_bytes
        self._held = 0
        self._packed: OrderedDict[bytes, bytes] = OrderedDict()
        self._changing = threading.Lock()

    @property
    def held_bytes(self) -> int:
        """How many are kept."""
        return self._held

    def read(self, form: Form, stream: bytes) -> tuple[PlaneCodes, Codes]:
        """As `read_points`. Raises DataLoss."""
        key = _key(form, stream)
        packed = self._known(key)
        if packed is None:
            codes, features = read_points(form, stream)
            self._keep(key, form, codes)
            return codes, features
        return _unpacked(form, packed), np.zeros((form.count, 0), np.int32)

    def keep(self, form: Form, stream: bytes, codes: PlaneCodes) -> None:
        """Keep the codes that reading the stream will give."""
        self._keep(_key(form, stream), form, codes)

    def _known(self, key: bytes) -> bytes | None:
        with self._changing:
            packed = self._packed.get(key)
            if packed is not None:
                self._packed.move_to_end(key)
            return packed

    def _keep(self, key: bytes, form: Form, codes: PlaneCodes) -> None:
        packed = None if form.features or self._known(key) is not None else _packed(form, codes)
        if packed is None:
            return
        with self._changing:
            self._held += len(packed) - len(self._packed.pop(key, b""))
            self._packed[key] = packed
            while self._held > self._most:
                self._held -= len(self._packed.popitem(last=False)[1])


def _key(form: Form, stream: bytes) -> bytes:
    return hashlib.sha256(repr(form.announced()).encode() + stream).digest()


def _packed(form: Form, codes: PlaneCodes) -> bytes | None:
    """A column after the other, compressed; None where a number is too large."""
    columns = ((codes.voxels - np.asarray(form.low, np.int32), _VOXEL), (codes.planes, _PLANE))
    small = [(whole, whole.astype(kind)) for whole, kind in columns]
    if not all(np.array_equal(whole, less) for whole, less in small):
        return None
    body = b"".join(np.ascontiguousarray(less.T).tobytes() for _, less in small)
    return zstandard.ZstdCompressor(level=_LEVEL).compress(body)


def _unpacked(form: Form, packed: bytes) -> PlaneCodes:
    """The inverse of `_packed`."""
    body = zstandard.ZstdDecompressor().decompress(packed)
    split = 3 * form.count * _VOXEL.itemsize
    voxels = _rows(body[:split], _VOXEL, 3) + np.asarray(form.low, np.int32)
    return PlaneCodes(voxels, _rows(body[split:], _PLANE, 4))


def _rows(body: bytes, kind: np.dtype[np.generic], columns: int) -> NDArray[np.int32]:
    rows = np.frombuffer(body, kind)
    return np.ascontiguousarray(rows.reshape(columns, len(rows) // columns).T.astype(np.int32))
