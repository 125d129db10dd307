"""Watching a map through lost connections: each event once, none left out."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

from revisit.sdk.errors import ApiError
from revisit.sdk.resources import Event
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import Transport
from revisit.v1 import event_pb2

if TYPE_CHECKING:
    from typing import Self

RECONNECT = RetryPolicy(base_s=0.2, cap_s=10.0)
"""The pauses between two attempts to connect; there is no last one."""


class Watch:
    """The events of a map, for as long as the loop over it goes on.

    A lost connection, a service that starts again and other retryable failures are bridged: it connects again and goes
    on behind `number`. Keep that number to go on behind it in another process.
    """

    def __init__(
        self, transport: Transport, request: event_pb2.WatchEventsRequest, retry: RetryPolicy = RECONNECT
    ) -> None:
        """`request` names the map, and the event to begin behind."""
        self._transport = transport
        self._request = request
        self._retry = retry
        self._closed = threading.Event()

    @property
    def number(self) -> int | None:
        """The last event that was given; None before the first connection of a watch from now on."""
        return self._request.after if self._request.HasField("after") else None

    def close(self) -> None:
        """End the loop with the next event or sign of life, after 15 s at the latest."""
        self._closed.set()

    def __iter__(self) -> Iterator[Event]:
        """The events. Raises ApiError where trying again is of no use: NotFound, Unauthenticated, ..."""
        failures = 0
        while not self._closed.is_set():
            asked_s: float | None = None
            try:
                for message in self._transport.watch(self._request):
                    failures = 0
                    if self._closed.is_set():
                        return
                    if message is not None:
                        yield from self._noted(message)
            except ApiError as error:
                if not error.retryable:
                    raise
                asked_s = error.retry_after_s
            failures += 1
            self._closed.wait(self._retry.pause_s(failures, asked_s))

    def _noted(self, message: event_pb2.Event) -> Iterator[Event]:
        event = Event.of(message)
        # Noted before it is given: a caller that leaves the loop with it has had it.
        self._request.after = event.number
        if event.kind != "OPENED":
            yield event

    def __enter__(self) -> Self:
        """The watch itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """See `close`."""
        self.close()
