"""The SDK over gRPC."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import grpc
from google.protobuf.json_format import MessageToDict, ParseDict
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, error_of, unreachable
from revisit.sdk.grpc_answers import LOST_AFTER_S, Answers, LostCall, answer
from revisit.sdk.resources import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_stream import GrpcScanSink
from revisit.sdk.transport import Forgetful, StreamJournal
from revisit.v1 import (
    cloud_pb2,
    ingest_pb2_grpc,
    loop_closure_pb2,
    loop_closure_pb2_grpc,
    map_pb2,
    map_pb2_grpc,
    operation_pb2,
    operation_pb2_grpc,
    robot_pb2,
    robot_pb2_grpc,
    session_pb2,
    session_pb2_grpc,
    submap_pb2,
    submap_pb2_grpc,
    system_pb2,
    system_pb2_grpc,
)

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

_COLLECTIONS: dict[str, tuple[Any, Any, str, str]] = {
    "maps": (map_pb2, map_pb2_grpc.MapServiceStub, "Map", "map"),
    "robots": (robot_pb2, robot_pb2_grpc.RobotServiceStub, "Robot", "robot"),
    "sessions": (session_pb2, session_pb2_grpc.SessionServiceStub, "Session", "session"),
    "submaps": (submap_pb2, submap_pb2_grpc.SubmapServiceStub, "Submap", "submap"),
    "operations": (operation_pb2, operation_pb2_grpc.OperationServiceStub, "Operation", "operation"),
    "loopClosures": (loop_closure_pb2, loop_closure_pb2_grpc.LoopClosureServiceStub, "LoopClosure", "loop_closure"),
}


class GrpcTransport:
    """`revisit.sdk.transport.Transport` over gRPC."""

    def __init__(self, address: str, retry: RetryPolicy, credentials: Credentials = Credentials()) -> None:
        self._address = address
        self._retry = retry
        self._metadata = tuple(credentials.authorization().items())
        host = address.removeprefix(TLS_PREFIX)
        self._channel = (
            grpc.insecure_channel(host, options=_OPTIONS)
            if host == address
            else grpc.secure_channel(host, _channel_credentials(credentials), options=_OPTIONS)
        )

    def create(self, parent: str, collection: str, resource_id: str, fields: Json) -> Json:
        """See Transport."""
        module, stub, noun, field = _COLLECTIONS[collection]
        request = {f"{field}_id": resource_id, **fields, **({"parent": parent} if parent else {})}
        return self._part(field, stub, f"Create{noun}", _message(module, f"Create{noun}Request", request))

    def get(self, name: str, *, full: bool = False) -> Json:
        """See Transport."""
        module, stub, noun, field = _COLLECTIONS[_collection_of(name)]
        asked = {"name": name, "view": "SUBMAP_VIEW_FULL"} if full else {"name": name}
        return self._part(field, stub, f"Get{noun}", _message(module, f"Get{noun}Request", asked))

    def list(self, parent: str, collection: str, filters: Json) -> Iterator[Json]:
        """See Transport."""
        module, stub, noun, field = _COLLECTIONS[collection]
        if "state" in filters:
            prefix = {"operations": "OPERATION_STATE_", "loopClosures": "LOOP_STATE_"}[collection]
            filters = {**filters, "state": prefix + filters["state"]}
        scope = {"parent": parent} if parent else {}
        token = ""
        while True:
            request = _message(module, f"List{noun}sRequest", {**scope, **filters, "page_token": token})
            page = self._answer(stub, f"List{noun}s", request)
            yield from page[f"{field}s"]
            token = page["next_page_token"]
            if not token:
                return

    def delete(self, name: str) -> None:
        """See Transport."""
        module, stub, noun, _ = _COLLECTIONS[_collection_of(name)]
        self._answer(stub, f"Delete{noun}", _message(module, f"Delete{noun}Request", {"name": name}))

    def finish_session(self, name: str) -> Json:
        """See Transport."""
        request = session_pb2.FinishSessionRequest(name=name)
        return self._part("session", session_pb2_grpc.SessionServiceStub, "FinishSession", request)

    def wait_operation(self, name: str, timeout_s: float) -> Json:
        """See Transport."""
        request = operation_pb2.WaitOperationRequest(name=name, timeout_s=timeout_s)
        return self._part("operation", operation_pb2_grpc.OperationServiceStub, "WaitOperation", request)

    def retry_operation(self, name: str) -> Json:
        """See Transport."""
        request = operation_pb2.RetryOperationRequest(name=name)
        return self._part("operation", operation_pb2_grpc.OperationServiceStub, "RetryOperation", request)

    def post_submap(self, session: str, submap_id: str, pose: Json, stamp_ns: int, cloud: Cloud) -> Json:
        """See Transport."""
        request = submap_pb2.PostSubmapRequest(
            parent=session, submap_id=submap_id, stamp_ns=stamp_ns, cloud=_cloud(cloud)
        )
        ParseDict(pose, request.t_odom_submap)
        return self._answer(submap_pb2_grpc.SubmapServiceStub, "PostSubmap", request)

    def download(self, submap: str, file_format: str) -> bytes:
        """See Transport."""
        request = submap_pb2.DownloadSubmapRequest(name=submap, format=f"DOWNLOAD_FORMAT_{file_format.upper()}")
        call = self._method(submap_pb2_grpc.SubmapServiceStub, "DownloadSubmap")
        limit_s = ANSWER_TIMEOUT_S + LOST_AFTER_S

        def whole() -> bytes:
            chunks = Answers(call(request, timeout=ANSWER_TIMEOUT_S, metadata=self._metadata))
            return b"".join(chunk.data for chunk in chunks.all(limit_s))

        return self._run(whole)

    def search(self, map_name: str, query: Any, criteria: Json) -> Json:
        """See Transport."""
        request = loop_closure_pb2.SearchSubmapsRequest(parent=map_name)
        if isinstance(query, Cloud):
            request.cloud.CopyFrom(_cloud(query))
        elif isinstance(query, str):
            request.submap = query
        else:
            ParseDict(query, request.descriptor)
        ParseDict(_with_vector_prior(criteria), request)
        return self._answer(loop_closure_pb2_grpc.LoopClosureServiceStub, "SearchSubmaps", request)

    def localize(self, map_name: str, cloud: Cloud, options: Json) -> Json:
        """See Transport."""
        request = loop_closure_pb2.LocalizeRequest(parent=map_name, cloud=_cloud(cloud))
        ParseDict(_with_vector_prior(options), request)
        return self._answer(loop_closure_pb2_grpc.LoopClosureServiceStub, "Localize", request)

    def status(self) -> Json:
        """See Transport."""
        return self._answer(system_pb2_grpc.SystemServiceStub, "GetStatus", system_pb2.GetStatusRequest())

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> GrpcScanSink:
        """See Transport."""
        call = partial(self._method(ingest_pb2_grpc.IngestServiceStub, "StreamScans"), metadata=self._metadata)
        return GrpcScanSink(call, session, self._retry, lambda error: _api_error(error, self._address), journal)

    def close(self) -> None:
        """See Transport."""
        self._channel.close()

    def _method(self, stub: Any, name: str) -> Callable[..., Any]:
        method: Callable[..., Any] = getattr(stub(self._channel), name)
        return method

    def _answer(self, stub: Any, method: str, request: Any) -> Json:
        called = self._method(stub, method)
        return _json(self._run(lambda: answer(called, request, ANSWER_TIMEOUT_S, self._metadata)))

    def _part(self, field: str, stub: Any, method: str, request: Any) -> Json:
        part: Json = self._answer(stub, method, request)[field]
        return part

    def _run(self, call: Callable[[], T]) -> T:
        def once() -> T:
            try:
                return call()
            except (grpc.RpcError, LostCall) as error:
                raise _api_error(error, self._address) from error

        return self._retry.run(once)


def _channel_credentials(credentials: Credentials) -> grpc.ChannelCredentials:
    files = (credentials.ca, credentials.key, credentials.certificate)
    return grpc.ssl_channel_credentials(*(None if file is None else file.read_bytes() for file in files))


def _message(module: Any, name: str, fields: Json) -> Any:
    return ParseDict(fields, getattr(module, name)())


def _json(message: Any) -> Json:
    return MessageToDict(message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)


def _cloud(cloud: Cloud) -> cloud_pb2.Cloud:
    return cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=cloud.content_type, data=cloud.data))


def _collection_of(name: str) -> str:
    parts = name.split("/")
    return parts[-2] if len(parts) > 1 and parts[-2] in _COLLECTIONS else "maps"


def _with_vector_prior(options: Json) -> Json:
    if "prior_position_m" not in options:
        return options
    x, y, z = options["prior_position_m"]
    return {**options, "prior_position_m": {"x": float(x), "y": float(y), "z": float(z)}}


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
