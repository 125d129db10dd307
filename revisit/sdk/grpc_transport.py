"""The SDK over gRPC."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import grpc
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.api.calls import CALLS
from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, error_of, unreachable
from revisit.sdk.grpc_answers import LOST_AFTER_S, Answers, LostCall, answer
from revisit.sdk.reading import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_stream import GrpcScanSink, holds_scan
from revisit.sdk.time_limit import remaining_s
from revisit.sdk.transport import MAX_FILE_BYTES, SILENT_S, Forgetful, StreamJournal
from revisit.v1 import event_pb2, loop_closure_pb2, map_file_pb2, mapping_pb2

MAX_MESSAGE_BYTES = 16 * 2**20
ANSWER_TIMEOUT_S = 90.0
TLS_PREFIX = "grpcs://"
STATUS_DETAILS = "grpc-status-details-bin"

_OPTIONS = (
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_send_message_length", 2 * MAX_MESSAGE_BYTES),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 2_000),
    ("grpc.enable_http_proxy", 0),
)

T = TypeVar("T")


class GrpcTransport:
    """`revisit.sdk.transport.Transport` over gRPC."""

    def __init__(self, address: str, retry: RetryPolicy, credentials: Credentials = Credentials()) -> None:
        self._address = address
        self._retry = retry
        self._metadata = tuple(credentials.authorization().items())
        self._methods: dict[str, Callable[..., Any]] = {}
        host = address.removeprefix(TLS_PREFIX)
        self._channel = (
            grpc.insecure_channel(host, options=_OPTIONS)
            if host == address
            else grpc.secure_channel(host, _channel_credentials(credentials), options=_OPTIONS)
        )

    def call(self, name: str, request: Any) -> Any:
        """See Transport."""
        call = CALLS[name]

        def once() -> Any:
            return answer(self._method(name), request, remaining_s(ANSWER_TIMEOUT_S), self._metadata)

        return call.body_in(self._run(once))

    def download(self, name: str, request: Any) -> bytes:
        """See Transport."""

        def whole() -> bytes:
            deadline_s = remaining_s(ANSWER_TIMEOUT_S)
            chunks = Answers(self._method(name)(request, timeout=deadline_s, metadata=self._metadata))
            return _joined(chunk.data for chunk in chunks.all(deadline_s + LOST_AFTER_S))

        return self._run(whole)

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """See Transport."""
        request = map_file_pb2.DownloadMapFileRequest(name=name, offset=offset)
        yield from (chunk.data for chunk in self._answers("DownloadMapFile", request) if chunk.data)

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """See Transport."""
        for response in self._answers("WatchEvents", request):
            yield response.event if response.HasField("event") else None

    def corrections(self, request: mapping_pb2.WatchCorrectionsRequest) -> GrpcCorrectionFeed:
        """See Transport."""
        call = self._method("WatchCorrections")(request, metadata=self._metadata)
        return GrpcCorrectionFeed(call, lambda error: _api_error(error, self._address))

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> GrpcScanSink:
        """See Transport."""
        return GrpcScanSink(
            self._stream_scans(), session, self._retry, lambda error: _api_error(error, self._address), journal
        )

    def open_conversation(self, opening: loop_closure_pb2.RelocaliseOpen) -> GrpcConversation:
        """See Transport."""
        call = partial(self._method("Relocalise"), metadata=self._metadata)
        return GrpcConversation(call, opening, lambda error: _api_error(error, self._address))

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """See Transport."""
        return self._run(lambda: holds_scan(self._stream_scans(), session, seq, cloud, pose, stamp_ns))

    def close(self) -> None:
        """See Transport."""
        self._channel.close()

    def _stream_scans(self) -> Callable[..., Any]:
        return partial(self._method("StreamScans"), metadata=self._metadata)

    def _answers(self, name: str, request: Any) -> Iterator[Any]:
        """The answers of a call that has several, until it ends or is left. Raises ApiError."""
        call = self._method(name)(request, metadata=self._metadata)
        try:
            yield from Answers(call).all(SILENT_S)
        except (grpc.RpcError, LostCall) as error:
            raise _api_error(error, self._address) from error
        finally:
            call.cancel()

    def _method(self, name: str) -> Callable[..., Any]:
        """The method of the channel that makes a call."""
        if name not in self._methods:
            call = CALLS[name]
            kinds = ("unary_unary", "unary_stream", "stream_unary", "stream_stream")
            kind = kinds[2 * call.method.client_streaming + call.method.server_streaming]
            parts = (call.path, call.request.SerializeToString, call.response.FromString)
            self._methods[name] = getattr(self._channel, kind)(*parts)
        return self._methods[name]

    def _run(self, call: Callable[[], T]) -> T:
        def once() -> T:
            try:
                return call()
            except (grpc.RpcError, LostCall) as error:
                raise _api_error(error, self._address) from error

        return self._retry.run(once)


class GrpcConversation:
    """`revisit.sdk.transport.ConversationCall` over a call of Relocalise."""

    def __init__(
        self,
        call: Callable[..., Any],
        opening: loop_closure_pb2.RelocaliseOpen,
        api_error: Callable[[Any], ApiError],
    ) -> None:
        self._requests: queue.SimpleQueue[loop_closure_pb2.RelocaliseRequest | None] = queue.SimpleQueue()
        self._requests.put(loop_closure_pb2.RelocaliseRequest(open=opening))
        self._call = call(iter(self._requests.get, None))
        self._answers = Answers(self._call)
        self._api_error = api_error

    def ask(self, scan: loop_closure_pb2.RelocaliseScan) -> loop_closure_pb2.RelocaliseResponse:
        """See ConversationCall."""
        self._requests.put(loop_closure_pb2.RelocaliseRequest(scan=scan))
        try:
            answered: loop_closure_pb2.RelocaliseResponse | None = self._answers.next(ANSWER_TIMEOUT_S)
        except (grpc.RpcError, LostCall) as error:
            raise self._api_error(error) from error
        if answered is None:
            raise unreachable("the service", "it ended the stream")
        return answered

    def close(self) -> None:
        """See ConversationCall."""
        self._requests.put(None)
        self._call.cancel()


class GrpcCorrectionFeed:
    """`revisit.sdk.transport.CorrectionFeed` over a call of WatchCorrections."""

    def __init__(self, call: Any, api_error: Callable[[Any], ApiError]) -> None:
        self._call = call
        self._answers = Answers(call)
        self._api_error = api_error

    def next(self, timeout_s: float) -> mapping_pb2.Correction | None:
        """See CorrectionFeed."""
        try:
            answered = self._answers.next(timeout_s)
        except LostCall:
            return None
        except grpc.RpcError as error:
            raise self._api_error(error) from error
        if answered is None:
            raise unreachable("the service", "it ended the stream")
        correction: mapping_pb2.Correction = answered.correction
        return correction

    def close(self) -> None:
        """See CorrectionFeed."""
        self._call.cancel()


def _joined(pieces: Iterator[bytes]) -> bytes:
    """A file from its pieces. Raises ApiError where they are more than a file may have."""
    whole = bytearray()
    for piece in pieces:
        whole += piece
        if len(whole) > MAX_FILE_BYTES:
            message = f"the file has more than {MAX_FILE_BYTES} bytes"
            raise error_of(ErrorDetails("RESOURCE_EXHAUSTED", "RESOURCE_EXHAUSTED", message))
    return bytes(whole)


def _channel_credentials(credentials: Credentials) -> grpc.ChannelCredentials:
    credentials.ssl_context()  # refuses files that gRPC would only log
    files = (credentials.ca, credentials.key, credentials.certificate)
    return grpc.ssl_channel_credentials(*(None if file is None else file.read_bytes() for file in files))


def _api_error(error: Any, address: str) -> ApiError:
    """The exception for a gRPC failure, from its google.rpc details where the service sent them."""
    if isinstance(error, LostCall):
        return unreachable(address, error)
    packed = dict(error.trailing_metadata() or ()).get(STATUS_DETAILS)
    if not isinstance(packed, bytes):
        # Calls of this client are not cancelled while somebody waits for them: the service ended before it answered.
        if error.code() in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED):
            return unreachable(address, error.details())
        return error_of(ErrorDetails(error.code().name, error.code().name, str(error.details())))
    info, request, bad, delay = (
        error_details_pb2.ErrorInfo(),
        error_details_pb2.RequestInfo(),
        error_details_pb2.BadRequest(),
        error_details_pb2.RetryInfo(),
    )
    status = status_pb2.Status.FromString(packed)
    for detail in status.details:
        any(detail.Unpack(message) for message in (info, request, bad, delay))
    expected = info.metadata.get("expected_seq")
    return error_of(
        ErrorDetails(
            code=error.code().name,
            reason=info.reason,
            message=status.message,
            retryable=info.metadata.get("retryable") == "true",
            request_id=request.request_id,
            field=bad.field_violations[0].field if bad.field_violations else None,
            retry_after_s=delay.retry_delay.ToMilliseconds() / 1000 if delay.HasField("retry_delay") else None,
            expected_seq=int(expected) if expected else None,
        )
    )
