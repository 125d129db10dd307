"""Waiting for gRPC, but not for ever.

With gRPC 1.85, the end of a call is sometimes lost if its connection was made while its service ended: the reader waits
for ever, past its deadline and past `cancel()`. So answers are waited for with a limit of our own.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

import grpc

LOST_AFTER_S = 5.0
"""How long after its deadline a call counts as lost."""


class LostCall(Exception):
    """gRPC says nothing about a call any more."""

    def __init__(self, silent_s: float) -> None:
        super().__init__(f"nothing was heard of the call for {silent_s:g} s")


def answer(method: Any, request: Any, deadline_s: float, metadata: tuple[tuple[str, str], ...]) -> Any:
    """The answer of a unary method. Raises grpc.RpcError, LostCall."""
    limit_s = deadline_s + LOST_AFTER_S
    try:
        return method.future(request, timeout=deadline_s, metadata=metadata).result(limit_s)
    except grpc.FutureTimeoutError as silence:
        raise LostCall(limit_s) from silence


class Answers:
    """The answers of a call that has several, read by a thread which is left behind where the call is lost."""

    def __init__(self, call: Any) -> None:
        """Begins to read `call`."""
        self._call = call
        self._arrived: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        threading.Thread(target=self._read, name="gRPC answers", daemon=True).start()

    def next(self, limit_s: float | None) -> Any:
        """The next answer, None behind the last. Raises grpc.RpcError, and LostCall after `limit_s` (None: never)."""
        try:
            response, error = self._arrived.get(timeout=limit_s)
        except queue.Empty as silence:
            raise LostCall(limit_s or 0.0) from silence
        if error is not None:
            raise error
        return response

    def all(self, limit_s: float) -> Iterator[Any]:
        """Every answer; each is waited for up to `limit_s`. Raises as `next`."""
        while (response := self.next(limit_s)) is not None:
            yield response

    def _read(self) -> None:
        error: grpc.RpcError | None = None
        try:
            for response in self._call:
                self._arrived.put((response, None))
        except grpc.RpcError as failure:
            error = failure
        finally:
            self._arrived.put((None, error))
