"""The SDK over REST."""

from __future__ import annotations

import json
import ssl
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TypeVar

import httpx
from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import Message

from revisit.api.calls import CALLS
from revisit.core.scan_marks import ScanMarks, Way
from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, FailedPrecondition, error_of, unreachable
from revisit.sdk.http_calls import AnswerTooLarge, HttpCalls, lines_of, read_whole
from revisit.sdk.http_requests import HttpRequest, cloud_arguments, http_request, pose_text
from revisit.sdk.json_answers import message_of
from revisit.sdk.messages import cloud_message
from revisit.sdk.reading import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import MAX_FILE_BYTES, SILENT_S, Forgetful, Refusal, StreamJournal, listed
from revisit.v1 import event_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_pb2, mapping_pb2, session_pb2

M = TypeVar("M", bound=Message)

CONNECT_TIMEOUT_S = 5.0
ALREADY_EXISTS = "ALREADY_EXISTS"
"""The reason of a refusal: the number is taken by another scan."""

POLL_S = 0.5
"""How often a feed asks whether there is something new."""

ANSWER_TIMEOUT_S = 90.0

NO_AUTHORITIES = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For an address without TLS: it would trust nobody, and reads no file of authorities (26 ms of each command)."""


class RestTransport:
    """`revisit.sdk.transport.Transport` over HTTP."""

    def __init__(self, base_url: str, retry: RetryPolicy, credentials: Credentials = Credentials()) -> None:
        timeout = httpx.Timeout(ANSWER_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        verify = credentials.ssl_context() if httpx.URL(base_url).scheme == "https" else NO_AUTHORITIES
        self._http = HttpCalls(base_url, timeout, credentials.authorization(), verify)
        self._base_url = base_url
        self._retry = retry

    def call(self, name: str, request: Any) -> Any:
        """See Transport."""
        call = CALLS[name]
        sent = http_request(call, request)
        if call.row.http.startswith("DELETE"):
            self._send(sent)
            return None
        return self._message(call.body, sent)

    def append_scan(
        self, session: str, seq: int, pose: Json, stamp_ns: int, cloud: Cloud
    ) -> ingest_pb2.AppendScanResponse:
        """Append one scan."""
        transform = ParseDict(pose, geometry_pb2.Transform())
        params = {"seq": seq, "stamp_ns": stamp_ns, "T_odom_sensor": pose_text(transform)}
        sent = HttpRequest("POST", f"/v1/{session}/scans", cloud_arguments(cloud_message(cloud), params))
        return self._message(ingest_pb2.AppendScanResponse, sent)

    def download(self, name: str, request: Any) -> bytes:
        """See Transport."""
        sent = http_request(CALLS[name], request)
        # Formats are the enum's names in lower case.
        given = sent.arguments["params"]
        params = {key: one.lower() if isinstance(one, str) else one for key, one in given.items()}
        arguments = {"params": params, "most_bytes": MAX_FILE_BYTES}
        return self._send(HttpRequest(sent.verb, sent.path, arguments)).content

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """See Transport."""
        headers = {"range": f"bytes={offset}-"} if offset else {}
        with self._answered(f"/v1/{name}:download", headers=headers) as answered:
            yield from answered.iter_bytes()

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """See Transport."""
        sent = http_request(CALLS["WatchEvents"], request)
        timeout = httpx.Timeout(SILENT_S, connect=CONNECT_TIMEOUT_S)
        with self._answered(sent.path, timeout=timeout, **sent.arguments) as answered:
            yield from events_of(lines_of(answered.iter_bytes()))

    @contextmanager
    def _answered(self, path: str, **arguments: Any) -> Iterator[httpx.Response]:
        """An answer that comes in pieces. Raises ApiError."""
        try:
            with self._http.client.stream("GET", path, **arguments) as answered:
                if not answered.is_success:
                    raise error_of(_details(read_whole(answered)))
                yield answered
        except httpx.TransportError as error:
            raise unreachable(self._base_url, error) from error
        except AnswerTooLarge as error:
            raise _too_large(error) from error

    def corrections(self, request: mapping_pb2.WatchCorrectionsRequest) -> RestCorrectionFeed:
        """See Transport."""
        return RestCorrectionFeed(self, request)

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> RestScanSink:
        """See Transport."""
        return RestScanSink(self, session, journal)

    def open_conversation(self, opening: loop_closure_pb2.RelocaliseOpen) -> NoReturn:
        """See Transport: HTTP has no stream in both directions."""
        message = "a conversation needs gRPC: make the client by Client.grpc()"
        raise FailedPrecondition(ErrorDetails("FAILED_PRECONDITION", "NEEDS_GRPC", message))

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """See Transport."""
        if int(session_of(self, session).committed_seq) < seq:
            return False
        try:
            self.append_scan(session, seq, pose, stamp_ns, cloud)
        except ApiError as error:
            if error.reason != ALREADY_EXISTS and not _is_for_good(error):
                raise
            return False
        return True

    def close(self) -> None:
        """See Transport."""
        self._http.close()

    def _message(self, kind: type[M], sent: HttpRequest) -> M:
        """The answer, which is the JSON of a message; fields of a newer service are ignored."""
        answered = self._send(sent)
        try:
            return message_of(kind, answered.json())
        except (ValueError, ParseError) as error:
            details = ErrorDetails("UNKNOWN", "FOREIGN_ANSWER", f"{sent.path} was not answered by this service")
            raise error_of(details) from error

    def _send(self, sent: HttpRequest) -> httpx.Response:
        return self._retry.run(lambda: self._send_once(sent))

    def _send_once(self, sent: HttpRequest) -> httpx.Response:
        try:
            answer = self._http.request(sent.verb, sent.path, **sent.arguments)
        except httpx.TransportError as error:
            raise unreachable(self._base_url, error) from error
        except AnswerTooLarge as error:
            raise _too_large(error) from error
        if answer.is_success:
            return answer
        raise error_of(_details(answer))


def session_of(transport: RestTransport, name: str) -> session_pb2.Session:
    """A session by its name."""
    session: session_pb2.Session = transport.call("GetSession", session_pb2.GetSessionRequest(name=name))
    return session


class RestScanSink:
    """Scans one request each, for networks that only let HTTP through."""

    def __init__(self, transport: RestTransport, session: str, journal: StreamJournal) -> None:
        self._transport = transport
        self._session = session
        self._journal = journal
        self._committed_seq = int(session_of(transport, session).committed_seq)
        journal.opened(self._committed_seq, "")
        self.submaps: list[str] = []
        self.submap_seq = 0
        self.refusals: list[Refusal] = []
        self.marks: ScanMarks | None = None
        self.way: Way | None = None
        self.left_out = 0

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably."""
        return self._committed_seq

    def send(self, cloud: Cloud, pose: Json, stamp_ns: int, travelled_m: float | None = None) -> None:
        """See ScanSink. Over HTTP all scans are sent: the service itself counts the way."""
        del travelled_m
        seq = self._committed_seq + 1
        try:
            ack = self._transport.append_scan(self._session, seq, pose, stamp_ns, cloud)
        except ApiError as error:
            if not _is_for_good(error):
                raise
            self._journal.refused(seq, error.reason, error.message)
            self.refusals.append(Refusal(seq, error.reason, error.message))
            return
        self._committed_seq = ack.committed_seq
        self.left_out += ack.left_out
        self._journal.committed(self._committed_seq)
        if ack.HasField("submap"):
            self.submaps.append(ack.submap.submap.name)
            self.submap_seq = ack.submap.submap.seq

    def live(self, pose: Json, stamp_ns: int) -> None:
        """See ScanSink: there is no connection to hold."""

    def check(self) -> None:
        """See ScanSink: there is no connection that could end."""

    def flush(self) -> None:
        """See ScanSink: every `send` waited for its answer."""

    def close(self) -> None:
        """See ScanSink: the connection is the transport's."""


def _is_for_good(error: ApiError) -> bool:
    """Whether a scan is refused for its content."""
    return error.code == "INVALID_ARGUMENT" or error.reason == "TOO_LARGE"


def events_of(lines: Iterator[str]) -> Iterator[event_pb2.Event | None]:
    """The events of a stream of server-sent events. Raises ApiError for a problem that is told in it."""
    kind, data = "", ""
    for line in lines:
        name, _, value = line.partition(": ")
        if name == "event":
            kind = value
        elif name == "data":
            data = value
        elif line.startswith(":"):
            yield None
        elif not line and data:
            if kind == "problem":
                raise error_of(_problem_details(json.loads(data)))
            yield message_of(event_pb2.Event, json.loads(data))
            kind, data = "", ""


def _problem_details(problem: Json, retry_after_s: float | None = None) -> ErrorDetails:
    return ErrorDetails(
        code=problem["code"],
        reason=problem["reason"],
        message=problem["detail"],
        retryable=bool(problem["retryable"]),
        request_id=problem["request_id"],
        field=problem.get("field"),
        retry_after_s=retry_after_s,
        expected_seq=problem.get("expected_seq"),
    )


class RestCorrectionFeed:
    """`revisit.sdk.transport.CorrectionFeed` by asking for the version of the map again and again."""

    def __init__(self, transport: RestTransport, request: mapping_pb2.WatchCorrectionsRequest) -> None:
        self._transport = transport
        self._map_name = request.parent
        self._session = request.session
        self._after = request.after
        self._news: deque[mapping_pb2.Correction] = deque()
        self._closed = threading.Event()

    def next(self, timeout_s: float) -> mapping_pb2.Correction | None:
        """See CorrectionFeed."""
        deadline = time.monotonic() + timeout_s
        while not self._news:
            self._look()
            if self._news:
                break
            if time.monotonic() >= deadline or self._closed.wait(POLL_S):
                return None
        return self._news.popleft()

    def _look(self) -> None:
        current = self._transport.call("GetMap", map_pb2.GetMapRequest(name=self._map_name))
        if current.map_version <= self._after:
            return
        self._after = current.map_version
        for session in [self._session] if self._session else self._sessions():
            with suppress(FailedPrecondition):  # a session that came after the version
                request = mapping_pb2.GetCorrectionRequest(name=session)
                self._news.append(self._transport.call("GetCorrection", request))

    def _sessions(self) -> Iterator[str]:
        asked = session_pb2.ListSessionsRequest(parent=self._map_name)
        yield from (session.name for session in listed(self._transport, "ListSessions", asked))

    def close(self) -> None:
        """See CorrectionFeed."""
        self._closed.set()


def _too_large(error: AnswerTooLarge) -> ApiError:
    """As gRPC's channel refuses a message."""
    return error_of(ErrorDetails("RESOURCE_EXHAUSTED", "RESOURCE_EXHAUSTED", str(error)))


def _details(answer: httpx.Response) -> ErrorDetails:
    try:
        retry_after_s = float(answer.headers["retry-after"]) if "retry-after" in answer.headers else None
        return _problem_details(answer.json(), retry_after_s)
    except (ValueError, KeyError, TypeError):
        # Not our service's answer: a proxy's page, for example.
        unavailable = answer.status_code in (502, 503, 504)
        code = "UNAVAILABLE" if unavailable else "UNKNOWN"
        return ErrorDetails(code, "FOREIGN_ANSWER", f"HTTP {answer.status_code}", retryable=unavailable)
