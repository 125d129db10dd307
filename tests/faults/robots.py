"""Robots behind a bad link: they note what they send and what they are told, and never give up."""

from __future__ import annotations

import hashlib
import queue
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import lru_cache
from typing import TypeVar

import grpc
import httpx

from revisit import ApiError, Client, Cloud
from revisit.core.errors import ErrorCode
from revisit.formats import KITTI, encode_kitti
from revisit.sdk.retry import RetryPolicy
from revisit.service.status import STATUS
from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, ingest_pb2_grpc
from tests.faults.history import History, Kind, Operation, Outcome
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose

T = TypeVar("T")

POINTS = 120
TOO_FEW_POINTS = 50
UNROTATED = geometry_pb2.Quaternion(w=1.0)
ONCE = RetryPolicy(attempts=1)
_FRESH_CHANNEL = (("grpc.use_local_subchannel_pool", 1), ("grpc.enable_http_proxy", 0))
"""A new connection for every attempt, without waiting because an earlier one failed."""


HANGS_AFTER_S = 95.0
"""Beyond every deadline. A call of gRPC 1.85 whose connection is made just as the service ends may hang for ever."""

EXPECTED = frozenset({409, 429, 503, 504})
"""Refusals, as HTTP names them, that a robot on a bad link may meet."""


@lru_cache(maxsize=10_000)
def body(place: int, points: int = POINTS) -> bytes:
    """The cloud of a place as it is sent."""
    return encode_kitti(cloud_points(place, points))


@lru_cache(maxsize=10_000)
def content(place: int, points: int = POINTS) -> str:
    """The hash by which its sender knows the cloud of a place again."""
    return hashlib.sha256(cloud_points(place, points).tobytes()).hexdigest()


def outcome_of(status: int) -> Outcome:
    """What the HTTP status of an answer to a post tells: a 4xx was not stored, anything else but 202 may be."""
    if status == 202:
        return Outcome.OK
    return Outcome.FAIL if 400 <= status < 500 else Outcome.UNKNOWN


def bounded(work: Callable[[], T]) -> T:
    """The result of `work`, which is left where it hangs. Raises TimeoutError then."""
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:  # noqa: BLE001  # carried to whoever waits for it
            outcome.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return outcome.result(HANGS_AFTER_S)


class Poster:
    """Posts submaps, each attempt on a connection of its own, over REST or gRPC; the repeating is up to the caller."""

    def __init__(self, name: str, session: str, history: History, expected: frozenset[int] = EXPECTED) -> None:
        """`session` is maps/{map}/sessions/{session}; a refusal that is not `expected` is a surprise."""
        self.name = name
        self.bodies: dict[str, list[dict[str, object]]] = {}
        self.replays: dict[str, bool] = {}
        self.surprises: list[str] = []
        self._session = session
        self._history = history
        self._expected = expected

    def post(self, http: str, submap_id: str, place: int, points: int = POINTS) -> Outcome:
        """One attempt over REST at the URL `http`."""
        operation = self._history.invoke(self.name, Kind.PUT, f"submap/{submap_id}", content(place, points))
        asked = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
        url = f"{http}/v1/{self._session}/submaps"
        try:
            # Without certificates to check there are none to load, which takes longer than the call.
            with httpx.Client(verify=False, trust_env=False, timeout=PATIENCE_S) as client:
                answer = client.post(url, params=asked, content=body(place, points), headers={"Content-Type": KITTI})
        except httpx.HTTPError:
            return self._settle(operation, Outcome.UNKNOWN)
        if answer.status_code == 202:
            self.bodies.setdefault(submap_id, []).append(answer.json())
            self.replays[submap_id] = answer.headers.get("idempotent-replay") == "true"
        elif answer.status_code not in self._expected:
            self.surprises.append(f"{answer.status_code} {answer.text}")
        return self._settle(operation, outcome_of(answer.status_code))

    def create(self, target: str, submap_id: str, place: int, points: int = POINTS) -> Outcome:
        """One attempt over gRPC at host:port."""
        operation = self._history.invoke(self.name, Kind.PUT, f"submap/{submap_id}", content(place, points))
        cloud = Cloud(body(place, points), KITTI)

        def post() -> None:
            with Client.grpc(target, retry=ONCE) as client:
                client.post_submap(self._session, submap_id, cloud, pose(float(place)), place)

        try:
            bounded(post)
        except TimeoutError:
            return self._settle(operation, Outcome.UNKNOWN)
        except ApiError as error:
            status = _http_status(error)
            if status not in self._expected:
                self.surprises.append(str(error))
            return self._settle(operation, outcome_of(status))
        return self._settle(operation, Outcome.OK)

    def _settle(self, operation: Operation, outcome: Outcome) -> Outcome:
        self._history.settle(operation, outcome)
        return outcome


def _http_status(error: ApiError) -> int:
    """The status by which HTTP would have refused; 503 for no answer at all."""
    if error.reason == "UNREACHABLE":
        return 503
    return STATUS[ErrorCode[error.reason]].http if error.reason in ErrorCode.__members__ else 500


class Scanner:
    """Streams scans 1, 2, 3, ... of a session: after every cut it opens again and goes on where the service says."""

    def __init__(self, session: str, history: History, expected: frozenset[str] = frozenset()) -> None:
        """`session` is maps/{map}/sessions/{session}; a Nack whose reason is not `expected` is a surprise."""
        self.committed_seq = 0
        self.most_resent = 0
        self.surprises: list[str] = []
        self._session = session
        self._history = history
        self._expected = expected
        self._open: dict[int, Operation] = {}
        self._furthest = 0

    def stream(self, target: str, until_seq: int) -> bool:
        """One connection; whether scan `until_seq` is acknowledged in the end. A link that fails is no surprise."""
        requests: queue.SimpleQueue[ingest_pb2.StreamScansRequest | None] = queue.SimpleQueue()
        requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=self._session)))
        resuming = self._history.invoke("scanner", Kind.RESUME, "stream")

        def talk() -> None:
            with grpc.insecure_channel(target, options=_FRESH_CHANNEL) as channel:
                stub = ingest_pb2_grpc.IngestServiceStub(channel)
                self._talk(
                    stub.StreamScans(iter(requests.get, None), timeout=PATIENCE_S), requests, resuming, until_seq
                )

        try:
            bounded(talk)
        except TimeoutError:
            return False
        except grpc.RpcError as error:
            if error.code() not in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.ABORTED, grpc.StatusCode.CANCELLED):
                self.surprises.append(f"{error.code()} {error.details()}")
        finally:
            requests.put(None)
        return self.committed_seq >= until_seq

    def _talk(
        self,
        answers: Iterator[ingest_pb2.StreamScansResponse],
        requests: queue.SimpleQueue[ingest_pb2.StreamScansRequest | None],
        resuming: Operation,
        until_seq: int,
    ) -> None:
        opened = next(answers).opened
        self._history.settle(resuming, Outcome.OK, opened.committed_seq)
        self._commit(opened.committed_seq)
        self.most_resent = max(self.most_resent, self._furthest - opened.committed_seq)
        sent, credits = opened.committed_seq, opened.credits
        while True:
            while sent < until_seq and sent - self.committed_seq < credits:
                sent += 1
                requests.put(self._scan(sent))
            if self.committed_seq >= until_seq:
                requests.put(None)
            answer = next(answers, None)
            if answer is None or answer.WhichOneof("response") == "drain":
                return
            if answer.WhichOneof("response") == "nack":
                nack = answer.nack
                if nack.reason not in self._expected:
                    self.surprises.append(f"{nack.seq}: {nack.reason}, expected {nack.expected_seq}")
                return
            if answer.WhichOneof("response") == "ack":
                told = self._history.invoke("scanner", Kind.RESUME, "stream")
                self._history.settle(told, Outcome.OK, answer.ack.committed_seq)
                self._commit(answer.ack.committed_seq)

    def _scan(self, seq: int) -> ingest_pb2.StreamScansRequest:
        if seq not in self._open:
            self._open[seq] = self._history.invoke("scanner", Kind.PUT, f"scan/{seq}", content(seq))
        self._furthest = max(self._furthest, seq)
        encoded = cloud_pb2.EncodedCloud(content_type=KITTI, data=body(seq))
        taken_from = geometry_pb2.Transform(translation=geometry_pb2.Vector3(x=0.5 * seq), rotation=UNROTATED)
        scan = ingest_pb2.Scan(seq=seq, stamp_ns=seq, t_odom_sensor=taken_from, cloud=cloud_pb2.Cloud(encoded=encoded))
        return ingest_pb2.StreamScansRequest(scan=scan)

    def _commit(self, committed_seq: int) -> None:
        self.committed_seq = max(self.committed_seq, committed_seq)
        for seq in [seq for seq in self._open if seq <= committed_seq]:
            self._history.settle(self._open.pop(seq), Outcome.OK)


class Crew:
    """Threads that work until told to stop."""

    def __init__(self) -> None:
        self.stop = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self, work) -> None:
        """Call `work` again and again."""

        def repeat() -> None:
            while not self.stop.is_set():
                work()

        self._threads.append(threading.Thread(target=repeat, daemon=True))
        self._threads[-1].start()

    def end(self, timeout_s: float = 120.0) -> None:
        """Let every thread finish what it does."""
        self.stop.set()
        for thread in self._threads:
            thread.join(timeout_s)
            assert not thread.is_alive(), f"a client hangs:\n{_stack_of(thread)}"


def _stack_of(thread: threading.Thread) -> str:
    return "".join(traceback.format_stack(sys._current_frames()[thread.ident]))
