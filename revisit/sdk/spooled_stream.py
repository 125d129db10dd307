"""A stream that outlives bad links and restarts: scans go to the robot's disk, a thread brings them to the service."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from revisit.core.errors import RevisitError
from revisit.sdk.clouds import PointsLike, encoded
from revisit.sdk.errors import ApiError
from revisit.sdk.input_watch import InputWatch
from revisit.sdk.messages import pose_json
from revisit.sdk.reading import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_choice import UNMET, ScanChoice, Send
from revisit.sdk.spool import DeadLetter, Spool, SpoolState
from revisit.sdk.transport import Refusal, ScanSink, Transport

POLL_S = 0.25
CLOSE_S = 5.0
RECONNECT = RetryPolicy(attempts=1, base_s=0.5, cap_s=30.0)
"""Full jitter up to half a minute: a fleet that comes back does not come back at once."""


class SpooledStream:
    """The stream of a session by way of a `Spool`.

    `send` returns once the scan is on the robot's disk, connected or not. Leaving waits for nothing: unacknowledged
    scans stay in the spool, and are sent when a stream is opened on it again. `send` and `flush` are for one thread.
    """

    def __init__(
        self,
        transport: Transport,
        session: str,
        spool: Spool,
        full_wait_s: float,
        reconnect: RetryPolicy,
        prepare: Callable[[], None] | None = None,
        send: Send = "described",
    ) -> None:
        """A full spool refuses a scan after `full_wait_s`; for `prepare` see `SpoolSender`."""
        self._choice = ScanChoice(send, spool.way)
        self._spool = spool
        self._full_wait_s = full_wait_s
        self._watch = InputWatch()
        self._sender = SpoolSender(transport, session, spool, reconnect, prepare)

    @property
    def state(self) -> SpoolState:
        """Waiting scans of the robot, and the last stored one of the service."""
        return self._spool.state

    @property
    def committed_seq(self) -> int:
        """The last scan that the service is known to have stored, 0 before it was met."""
        return self._spool.state.committed_seq or 0

    @property
    def rejected(self) -> list[tuple[int, str]]:
        """The dead letters in short: number and reason."""
        return [(dead.seq, dead.reason) for dead in self.dead_letters]

    @property
    def refusals(self) -> list[Refusal]:
        """The dead letters without their clouds."""
        return [Refusal(dead.seq, dead.reason, dead.message) for dead in self.dead_letters]

    @property
    def error(self) -> Exception | None:
        """Why nothing is sent any more; None while it is, or will be once the service can be reached."""
        return self._sender.error

    @property
    def dead_letters(self) -> list[DeadLetter]:
        """The scans that the service refused for good, oldest first."""
        return self._spool.dead_letters()

    @property
    def skipped(self) -> int:
        """Scans of this stream that were not sent, as no description would be made of them."""
        return self._choice.left_out

    @property
    def submaps(self) -> list[str]:
        """Names of the submaps that the scans completed since this stream was opened."""
        return self._sender.submaps

    def send(self, points: PointsLike, T_odom_sensor: Any, stamp_ns: int) -> None:
        """Store the next scan on the robot, if it is one of those to send. Raises core.errors.BadTransform, SpoolFull,
        SpoolUnusable.

        Warns of `SuspiciousInput`.
        """
        self._watch.look(points, T_odom_sensor, stamp_ns)
        pose = pose_json(T_odom_sensor)
        scan = self._choice.look(pose, points, self._spool.marks or UNMET)
        if scan.chosen is not None:
            self._spool.append(encoded(points), pose, stamp_ns, self._full_wait_s, scan.way.travelled_m)
            self._choice.sent(scan.chosen)
        elif self._choice.passed_over():
            self._sender.live(pose, stamp_ns)

    def flush(self, timeout_s: float = float("inf")) -> None:
        """Wait until the service has answered every scan. Raises the error that ended the sending; TimeoutError."""
        self._sender.wait_until_empty(timeout_s)

    def close(self) -> None:
        """Stop sending; the scans in the spool stay there."""
        self._sender.close()
        self._spool.close()


class SpoolSender:
    """The thread that empties a spool into a session: connects, sends, connects again."""

    def __init__(
        self,
        transport: Transport,
        session: str,
        spool: Spool,
        reconnect: RetryPolicy,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        """Begins at once. `prepare` makes the session, before the first connection; it may raise ApiError."""
        self._prepare = prepare
        self._transport = transport
        self._session = session
        self._spool = spool
        self._reconnect = reconnect
        self._closing = threading.Event()
        self._sink: ScanSink | None = None
        self._submaps: list[str] = []
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name=f"spool {session}", daemon=True)
        self._thread.start()

    @property
    def submaps(self) -> list[str]:
        """Names of the submaps that the scans completed so far."""
        sink = self._sink
        return self._submaps + (sink.submaps if sink is not None else [])

    def live(self, pose: Json, stamp_ns: int) -> None:
        """Tell the service that the robot is there, if there is a connection."""
        sink = self._sink
        if sink is not None:
            sink.live(pose, stamp_ns)

    def wait_until_empty(self, timeout_s: float) -> None:
        """Raises the error that ended the sending; TimeoutError."""
        deadline = time.monotonic() + timeout_s
        while not self._spool.wait_until_empty(min(POLL_S, max(0.0, deadline - time.monotonic()))):
            if self.error is not None:
                raise self.error
            if time.monotonic() >= deadline:
                raise TimeoutError(f"{self._spool.state.pending} scans are not sent after {timeout_s:g} s")

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self._spool.wake()
        sink = self._sink
        if sink is not None:
            sink.close()
        # A connection that is only just being made is not waited for; the thread ends with it.
        self._thread.join(timeout=CLOSE_S)

    def _run(self) -> None:
        failures = 0
        while not self._closing.is_set():
            try:
                self._prepare_once()
                self._sink = self._transport.open_stream(self._session, self._spool)
                failures = 0
                self._send_all(self._sink)
            except ApiError as error:
                self._leave()
                if not error.retryable:
                    self.error = error
                    return
                failures += 1
                self._closing.wait(self._reconnect.pause_s(failures, error.retry_after_s))
            except RevisitError as error:
                self.error = error
                self._leave()
                return
            except Exception:
                # Of a channel, a client or a spool that was closed while this connects.
                if not self._closing.is_set():
                    raise
        self._leave()

    def _prepare_once(self) -> None:
        if self._prepare is not None:
            self._prepare()
            self._prepare = None

    def _send_all(self, sink: ScanSink) -> None:
        """One connection: everything that waits, from the first scan on, then each new one. Raises ApiError."""
        number = 0
        while not self._closing.is_set():
            scan = self._spool.after(number, POLL_S)
            if scan is not None:
                sink.send(scan.cloud, scan.pose, scan.stamp_ns, scan.travelled_m)
                number = scan.number
            else:
                sink.check()

    def _leave(self) -> None:
        sink, self._sink = self._sink, None
        if sink is not None:
            self._submaps += sink.submaps
            sink.close()
