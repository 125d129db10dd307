"""Small blobs that were read lately, in the memory of a process: a worker asks for most places again and again."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable

MOST_BYTES = 16 * 2**20
"""Of all of them: 2,000 places."""

LARGEST_BYTES = 64 * 2**10
"""A larger blob is not kept: clouds are read once or twice."""


class RecentBlobs:
    """Bytes by key, those that were asked for last. Content does not change under its name, so none is ever old."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        """Begins empty."""
        self._most_bytes = most_bytes
        self._bytes = 0
        self._blobs: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: str) -> bytes | None:
        """The bytes, where they are kept."""
        with self._lock:
            data = self._blobs.get(key)
            if data is not None:
                self._blobs.move_to_end(key)
        return data

    def keep(self, key: str, data: bytes) -> None:
        """Keep bytes that were read and checked; those that nobody asked for longest go."""
        if len(data) > LARGEST_BYTES:
            return
        with self._lock:
            self._bytes += len(data) - len(self._blobs.pop(key, b""))
            self._blobs[key] = data
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._blobs.popitem(last=False)[1])

    def drop(self, keys: Iterable[str]) -> None:
        """Forget them."""
        with self._lock:
            for key in keys:
                self._bytes -= len(self._blobs.pop(key, b""))
