"""A conversation about where in a map a robot is: one answer to each scan, through lost connections."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from revisit.sdk.clouds import PointsLike
from revisit.sdk.errors import ApiError, ErrorDetails, closed, error_of
from revisit.sdk.messages import cloud_of, pose_message, request_of
from revisit.sdk.resources import Relocalisation
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import ConversationCall
from revisit.v1 import loop_closure_pb2 as pb


class Conversation:
    """The open conversation with a map. Calls are for one thread.

    A lost connection and a service that starts again are bridged: the conversation begins anew with the scan at hand,
    and what earlier scans had told is lost; `begun` counts that.
    """

    def __init__(self, open_call: Callable[[], ConversationCall], retry: RetryPolicy) -> None:
        """`open_call` begins a conversation with the service."""
        self._open_call = open_call
        self._retry = retry
        self._call: ConversationCall | None = None
        self._closed = threading.Event()
        self._begun = 0
        self._last: Relocalisation | None = None

    @property
    def begun(self) -> int:
        """How often the conversation was begun: once, and again after each lost connection."""
        return self._begun

    @property
    def last(self) -> Relocalisation | None:
        """The newest answer."""
        return self._last

    def see(self, points: PointsLike, T_odom_sensor: Any) -> Relocalisation:
        """What this scan, with those before it, tells: points (n, 3) metres in the sensor frame, and its pose (4, 4).

        Poses are of one odometry frame whose z points up. Raises ApiError, InvalidArgument for a scan that cannot be
        used: the conversation goes on with the next.
        """
        pose = pose_message(T_odom_sensor, "T_odom_sensor", required=True)
        scan = request_of(pb.RelocaliseScan, {"t_odom_sensor": pose, "cloud": cloud_of(points)})
        answer = Relocalisation.of(self._retry.run(lambda: self._asked(scan)))
        self._last = answer
        return answer

    def close(self) -> None:
        """End the conversation."""
        self._closed.set()
        self._drop()

    def _asked(self, scan: pb.RelocaliseScan) -> pb.RelocaliseAnswer:
        if self._closed.is_set():
            raise closed()
        if self._call is None:
            self._call = self._open_call()
            self._begun += 1
        try:
            response = self._call.ask(scan)
        except ApiError:
            self._drop()
            raise
        if response.WhichOneof("response") == "refusal":
            raise _error_of(response.refusal)
        return response.answer

    def _drop(self) -> None:
        if self._call is not None:
            self._call.close()
            self._call = None


def _error_of(refusal: pb.RelocaliseRefusal) -> ApiError:
    delay_s = refusal.retry_delay_s if refusal.HasField("retry_delay_s") else None
    return error_of(
        ErrorDetails(refusal.code, refusal.reason, refusal.message, refusal.retryable, retry_after_s=delay_s)
    )
