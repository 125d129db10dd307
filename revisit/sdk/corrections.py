"""Corrections as they come: to iterate over, or for a callback in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from revisit.sdk.errors import ApiError
from revisit.sdk.resources import Correction
from revisit.sdk.transport import CorrectionFeed, Transport
from revisit.v1 import mapping_pb2

if TYPE_CHECKING:
    from typing import Self

_LOOK_S = 0.5
"""How often a watch looks whether it was closed."""

_RECONNECT_S = 1.0


class CorrectionWatch:
    """The corrections of the sessions of a map. Connects again where the link breaks; the last ones may then repeat."""

    def __init__(self, transport: Transport, request: mapping_pb2.WatchCorrectionsRequest) -> None:
        """Connects when it is first used."""
        self._transport = transport
        self._request = request
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def __iter__(self) -> Iterator[Correction]:
        """The corrections, until the watch is closed. Raises ApiError where trying again does not help."""
        while not self._closed.is_set():
            feed = self._transport.corrections(self._request)
            try:
                yield from self._of(feed)
            except ApiError as error:
                if not error.retryable:
                    raise
                self._closed.wait(_RECONNECT_S)
            finally:
                feed.close()

    def _of(self, feed: CorrectionFeed) -> Iterator[Correction]:
        while not self._closed.is_set():
            message = feed.next(_LOOK_S)
            if message is not None:
                # The others of this version may still come: after a break, all of them come again.
                self._request.after = max(self._request.after, message.map_version - 1)
                yield Correction.of(message)

    def call(self, callback: Callable[[Correction], None]) -> Self:
        """Give each correction to `callback`, in a thread of this watch; close it to end that."""
        self._thread = threading.Thread(target=self._deliver, args=(callback,), name="corrections", daemon=True)
        self._thread.start()
        return self

    def _deliver(self, callback: Callable[[Correction], None]) -> None:
        for correction in self:
            callback(correction)

    def close(self) -> None:
        """End the watch; a callback that runs is waited for."""
        self._closed.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(10.0)

    def __enter__(self) -> Self:
        """The watch itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()
