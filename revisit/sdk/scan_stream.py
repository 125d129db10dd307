"""A session's scans over one gRPC stream: windowed, resumed after a disconnect, bad scans left out.

The window holds every scan that is not acknowledged. After a disconnect the stream opens again, learns the last
durable scan and sends the rest of the window; a scan that the service refuses for good is dropped and its successors
are renumbered; a busy service is waited for. Never more scans are unanswered than the service gave credits, nor more
bytes than its window has.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import grpc
from google.protobuf.json_format import ParseDict

from revisit.core.errors import RevisitError
from revisit.core.scan_marks import ScanMarks, Way
from revisit.sdk.clouds import Cloud
from revisit.sdk.errors import ApiError, ErrorDetails, Unavailable, closed, error_of, unreachable
from revisit.sdk.grpc_answers import Answers, LostCall
from revisit.sdk.reading import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_choice import marks_of, way_of
from revisit.sdk.transport import Forgetful, Refusal, StreamJournal
from revisit.v1 import cloud_pb2, ingest_pb2

ALREADY_EXISTS = "ALREADY_EXISTS"
"""The reason of a refusal that ends the sending: the number is taken by another scan."""

GIVE_UP_AFTER_S = 120.0
OPENED_WITHIN_S = 30.0
"""A service opens a stream at once. Later it may be silent as long as the robot is; keep-alives watch the link."""

DEFAULT_CREDITS = 32
DEFAULT_WINDOW_BYTES = 8 * 2**20


@dataclass(frozen=True)
class _Pending:
    """A scan that is not acknowledged; its number is its position after the committed one."""

    cloud: Cloud
    pose: Json
    stamp_ns: int
    travelled_m: float | None = None

    def message(self, seq: int) -> ingest_pb2.StreamScansRequest:
        """The scan as number `seq`."""
        encoded = cloud_pb2.EncodedCloud(content_type=self.cloud.content_type, data=self.cloud.data)
        cloud = cloud_pb2.Cloud(encoded=encoded)
        scan = ingest_pb2.Scan(seq=seq, stamp_ns=self.stamp_ns, cloud=cloud, travelled_m=self.travelled_m)
        ParseDict(self.pose, scan.t_odom_sensor)
        return ingest_pb2.StreamScansRequest(scan=scan)


class GrpcScanSink:
    """`revisit.sdk.transport.ScanSink` over `IngestService.StreamScans`. `send` and `flush` are for one thread."""

    def __init__(
        self,
        call: Callable[..., Any],
        session: str,
        retry: RetryPolicy,
        api_error: Callable[[Any], ApiError],
        journal: StreamJournal = Forgetful(),
    ) -> None:
        """Opens the stream and waits for it; the `journal` hears of each answer before the stream goes on."""
        self._journal = journal
        self._call = call
        self._session = session
        self._retry = retry
        self._api_error = api_error
        self._changed = threading.Condition()
        self._window: deque[_Pending] = deque()
        self._sent = 0
        self._unanswered = 0
        self._credits = DEFAULT_CREDITS
        self._window_bytes = DEFAULT_WINDOW_BYTES
        self._held_bytes = 0
        self._committed_seq = 0
        self._resend_at: float | None = None
        self._open = False
        self._met = False
        self._closing = False
        self._error: RevisitError | ApiError | None = None
        self._requests: queue.SimpleQueue[ingest_pb2.StreamScansRequest | None] = queue.SimpleQueue()
        self._running_call: Any = None
        self.submaps: list[str] = []
        self.submap_seq = 0
        self.loops: list[str] = []
        self.refusals: list[Refusal] = []
        self.marks: ScanMarks | None = None
        self.way: Way | None = None
        self.left_out = 0
        self._thread = threading.Thread(target=self._run, name=f"scans {session}", daemon=True)
        self._thread.start()
        with self._changed:
            self._wait_until(lambda: self._open)

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably."""
        return self._committed_seq

    def send(self, cloud: Cloud, pose: Json, stamp_ns: int, travelled_m: float | None = None) -> None:
        """Take the next scan; waits while the window is full. Raises ApiError."""
        with self._changed:
            self._wait_until(lambda: self._has_room(len(cloud.data)))
            self._window.append(_Pending(cloud, pose, stamp_ns, travelled_m))
            self._held_bytes += len(cloud.data)
            self._transmit()

    def live(self, pose: Json, stamp_ns: int) -> None:
        """See ScanSink. A service that announces no marks knows no poses without scans."""
        with self._changed:
            if self._open and self.marks is not None:
                told = ingest_pb2.Pose(stamp_ns=stamp_ns)
                ParseDict(pose, told.t_odom_sensor)
                self._requests.put(ingest_pb2.StreamScansRequest(pose=told))

    def check(self) -> None:
        """See ScanSink."""
        if self._error is not None:
            raise self._error

    def flush(self) -> None:
        """Wait until every scan was answered. Raises ApiError."""
        with self._changed:
            self._wait_until(lambda: not self._window)

    def close(self) -> None:
        """End the stream; scans that are not acknowledged are given up."""
        with self._changed:
            self._closing = True
            self._requests.put(None)
            self._changed.notify_all()
        self._thread.join(timeout=5.0)
        if self._running_call is not None:
            self._running_call.cancel()

    def _has_room(self, cloud_bytes: int) -> bool:
        """Whether one more scan fits; one alone always does."""
        within = self._held_bytes + cloud_bytes <= self._window_bytes or not self._window
        return within and len(self._window) < self._credits

    def _wait_until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            if self._error is not None:
                raise self._error
            if self._closing:
                raise closed()
            self._changed.wait(timeout=0.05)
            self._transmit()

    def _transmit(self) -> None:
        """Send scans up to the credits; with the lock held."""
        if not self._open:
            return
        if self._resend_at is not None:
            if self._unanswered or time.monotonic() < self._resend_at:
                return
            self._resend_at, self._sent = None, 0
        while self._sent < len(self._window) and self._unanswered < self._credits:
            self._requests.put(self._window[self._sent].message(self._committed_seq + self._sent + 1))
            self._sent += 1
            self._unanswered += 1

    def _run(self) -> None:
        failures, last_good = 0, time.monotonic()
        while not self._closing:
            try:
                if self._stream_once():
                    failures, last_good = 0, time.monotonic()
            except RevisitError as failure:
                self._fail(failure)
                return
            except ValueError:  # gRPC's word for a channel that was closed under the call
                self._fail(closed())
                return
            except (grpc.RpcError, LostCall) as rpc_error:
                error = self._api_error(rpc_error)
                if self._was_open():
                    failures, last_good = 0, time.monotonic()
                hopeless = time.monotonic() - last_good > GIVE_UP_AFTER_S
                never_met = not self._met and failures + 1 >= self._retry.attempts
                if not error.retryable or hopeless or never_met:
                    self._fail(error)
                    return
            self._disconnected()
            failures += 1
            time.sleep(0.0 if self._closing else self._retry.pause_s(failures))

    def _stream_once(self) -> bool:
        """One connection, from Open to its end; whether the service accepted it."""
        with self._changed:
            self._requests = queue.SimpleQueue()
        token, acknowledged_seq = self._journal.resume_point()
        opening = ingest_pb2.Open(session=self._session, resume_token=token, acknowledged_seq=acknowledged_seq)
        self._requests.put(ingest_pb2.StreamScansRequest(open=opening))
        if self._closing:
            self._requests.put(None)
        self._running_call = self._call(_until_none(self._requests))
        answers = Answers(self._running_call)
        while (response := answers.next(None if self._was_open() else OPENED_WITHIN_S)) is not None:
            with self._changed:
                drained = self._handle(response)
                self._transmit()
                self._changed.notify_all()
            if drained:
                self._running_call.cancel()
                break
        return self._was_open()

    def _handle(self, response: ingest_pb2.StreamScansResponse) -> bool:
        """Take an answer in; whether the service asked to leave. With the lock held."""
        match response.WhichOneof("response"):
            case "opened":
                self.marks = marks_of(response.opened)
                self.way = self.way if self._met else way_of(response.opened)
                self._journal.opened(response.opened.committed_seq, response.opened.resume_token, self.marks)
                self._commit(response.opened.committed_seq)
                self._credits = max(1, response.opened.credits)
                self._window_bytes = response.opened.window_bytes or DEFAULT_WINDOW_BYTES
                self._open = self._met = True
                self._sent, self._unanswered, self._resend_at = 0, 0, None
            case "ack":
                self._unanswered -= response.ack.credits
                self.left_out += response.ack.left_out
                self._journal.committed(response.ack.committed_seq)
                self.submap_seq = max(self.submap_seq, response.ack.submap_seq)
                self._commit(response.ack.committed_seq)
            case "nack":
                self._unanswered -= response.nack.credits
                self._refused(response.nack)
            case "submap_finished":
                self.submaps.append(response.submap_finished.name)
            case "loop_closed":
                self.loops.append(response.loop_closed.loop_closure.name)
            case "throttle":
                self._resend_at = time.monotonic() + response.throttle.retry_delay_s
            case "drain":
                return True
        return False

    def _commit(self, committed_seq: int) -> None:
        newly = max(0, committed_seq - self._committed_seq)
        self._committed_seq += newly
        for _ in range(min(newly, len(self._window))):
            self._drop_first()
        self._sent = max(0, self._sent - newly)

    def _drop_first(self) -> None:
        self._held_bytes -= len(self._window.popleft().cloud.data)

    def _refused(self, nack: ingest_pb2.Nack) -> None:
        if nack.reason == ALREADY_EXISTS:
            # Another robot, or this one before it restarted, has used the number: no later scan belongs here either.
            self._fail(error_of(ErrorDetails(ALREADY_EXISTS, nack.reason, nack.message)))
            return
        if nack.seq != nack.expected_seq or not self._window:
            return
        if not nack.retryable:
            self._journal.refused(nack.seq, nack.reason, nack.message)
            self._drop_first()
            self.refusals.append(Refusal(nack.seq, nack.reason, nack.message))
        else:
            self._journal.delayed(nack.reason, nack.message)
        # Scans behind the refused one are refused for the gap; they are sent again once that is answered.
        self._resend_at = max(self._resend_at or 0.0, time.monotonic())

    def _was_open(self) -> bool:
        return self._open

    def _disconnected(self) -> None:
        with self._changed:
            self._open = False
            self._requests.put(None)

    def _fail(self, error: RevisitError | ApiError) -> None:
        with self._changed:
            self._error = error
            self._changed.notify_all()


def holds_scan(call: Callable[..., Any], session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
    """Whether the session has this very scan under the number `seq`: sent again, it would be acknowledged.

    Takes a stream, which ends an open one of the session. Raises ApiError, grpc.RpcError, LostCall.
    """
    requests: queue.SimpleQueue[ingest_pb2.StreamScansRequest | None] = queue.SimpleQueue()
    requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=session)))
    running = call(_until_none(requests))
    try:
        for response in Answers(running).all(OPENED_WITHIN_S):
            match response.WhichOneof("response"):
                case "opened":
                    if response.opened.committed_seq < seq:
                        return False
                    requests.put(_Pending(cloud, pose, stamp_ns).message(seq))
                case "ack":
                    return True
                case "nack":
                    if response.nack.retryable:
                        reason, message = response.nack.reason, response.nack.message
                        raise Unavailable(ErrorDetails("UNAVAILABLE", reason, message, retryable=True))
                    return False
    finally:
        requests.put(None)
        running.cancel()
    raise unreachable("the service", "it ended the stream")


def _until_none(
    requests: queue.SimpleQueue[ingest_pb2.StreamScansRequest | None],
) -> Iterator[ingest_pb2.StreamScansRequest]:
    while (request := requests.get()) is not None:
        yield request
