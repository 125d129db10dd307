"""The SDK over gRPC."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import grpc
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, error_of, unreachable
from revisit.sdk.grpc_answers import LOST_AFTER_S, Answers, LostCall, answer
from revisit.sdk.messages import COLLECTIONS, collection_of, request_of
from revisit.sdk.resources import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.scan_stream import GrpcScanSink, holds_scan
from revisit.sdk.transport import SILENT_S, Forgetful, StreamJournal
from revisit.v1 import (
    event_pb2,
    event_pb2_grpc,
    ingest_pb2_grpc,
    loop_closure_pb2,
    loop_closure_pb2_grpc,
    map_file_pb2,
    map_file_pb2_grpc,
    map_pb2,
    map_pb2_grpc,
    map_tile_pb2,
    map_tile_pb2_grpc,
    mapping_pb2,
    mapping_pb2_grpc,
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
    webhook_pb2,
    webhook_pb2_grpc,
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

_STUBS: dict[str, Any] = {
    "maps": map_pb2_grpc.MapServiceStub,
    "robots": robot_pb2_grpc.RobotServiceStub,
    "sessions": session_pb2_grpc.SessionServiceStub,
    "submaps": submap_pb2_grpc.SubmapServiceStub,
    "events": loop_closure_pb2_grpc.LoopClosureServiceStub,
    "versions": mapping_pb2_grpc.MappingServiceStub,
    "merges": mapping_pb2_grpc.MappingServiceStub,
    "poses": mapping_pb2_grpc.MappingServiceStub,
    "tiles": map_tile_pb2_grpc.MapTileServiceStub,
    "files": map_file_pb2_grpc.MapFileServiceStub,
    "webhooks": webhook_pb2_grpc.WebhookServiceStub,
    "operations": operation_pb2_grpc.OperationServiceStub,
    "loopClosures": loop_closure_pb2_grpc.LoopClosureServiceStub,
}
_MODULES: dict[str, Any] = {
    "maps": map_pb2,
    "robots": robot_pb2,
    "sessions": session_pb2,
    "submaps": submap_pb2,
    "events": loop_closure_pb2,
    "versions": mapping_pb2,
    "merges": mapping_pb2,
    "poses": mapping_pb2,
    "tiles": map_tile_pb2,
    "files": map_file_pb2,
    "webhooks": webhook_pb2,
    "operations": operation_pb2,
    "loopClosures": loop_closure_pb2,
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

    def create(self, collection: str, request: Any) -> Any:
        """See Transport."""
        return self._resource(collection, "Create", request)

    def get(self, name: str, *, full: bool = False) -> Any:
        """See Transport."""
        collection = collection_of(name)
        request = _request("Get", collection, {"name": name, **({"view": "FULL"} if full else {})})
        return self._resource(collection, "Get", request)

    def list(self, collection: str, request: Any) -> Iterator[Any]:
        """See Transport."""
        while True:
            page = self._answer(_STUBS[collection], f"List{_noun(collection)}s", request)
            yield from getattr(page, f"{COLLECTIONS[collection].field}s")
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def delete(self, name: str) -> None:
        """See Transport."""
        collection = collection_of(name)
        request = _request("Delete", collection, {"name": name})
        self._answer(_STUBS[collection], f"Delete{_noun(collection)}", request)

    def finish_session(self, name: str) -> session_pb2.Session:
        """See Transport."""
        request = session_pb2.FinishSessionRequest(name=name)
        answered: session_pb2.FinishSessionResponse = self._answer(_STUBS["sessions"], "FinishSession", request)
        return answered.session

    def wait_operation(self, name: str, timeout_s: float) -> operation_pb2.Operation:
        """See Transport."""
        request = operation_pb2.WaitOperationRequest(name=name, timeout_s=timeout_s)
        answered: operation_pb2.WaitOperationResponse = self._answer(_STUBS["operations"], "WaitOperation", request)
        return answered.operation

    def retry_operation(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        request = operation_pb2.RetryOperationRequest(name=name)
        answered: operation_pb2.RetryOperationResponse = self._answer(_STUBS["operations"], "RetryOperation", request)
        return answered.operation

    def post_submap(self, request: submap_pb2.PostSubmapRequest) -> submap_pb2.PostSubmapResponse:
        """See Transport."""
        answered: submap_pb2.PostSubmapResponse = self._answer(_STUBS["submaps"], "PostSubmap", request)
        return answered

    def download(self, submap: str, file_format: str) -> bytes:
        """See Transport."""
        asked = {"name": submap, "format": file_format.upper()}
        return self._file("submaps", "DownloadSubmap", request_of(submap_pb2.DownloadSubmapRequest, asked))

    def download_tile(self, tile: str, file_format: str) -> bytes:
        """See Transport."""
        asked = {"name": tile, "format": file_format.upper()}
        return self._file("tiles", "DownloadMapTile", request_of(map_tile_pb2.DownloadMapTileRequest, asked))

    def _file(self, collection: str, method: str, request: Any) -> bytes:
        """A file that comes in chunks."""
        call = self._method(_STUBS[collection], method)
        limit_s = ANSWER_TIMEOUT_S + LOST_AFTER_S

        def whole() -> bytes:
            chunks = Answers(call(request, timeout=ANSWER_TIMEOUT_S, metadata=self._metadata))
            return b"".join(chunk.data for chunk in chunks.all(limit_s))

        return self._run(whole)

    def measure_distances(
        self, request: map_tile_pb2.MeasureMapDistancesRequest
    ) -> map_tile_pb2.MeasureMapDistancesResponse:
        """See Transport."""
        answered: map_tile_pb2.MeasureMapDistancesResponse
        answered = self._answer(_STUBS["tiles"], "MeasureMapDistances", request)
        return answered

    def find_points(self, request: map_tile_pb2.FindMapPointsRequest) -> map_tile_pb2.FindMapPointsResponse:
        """See Transport."""
        answered: map_tile_pb2.FindMapPointsResponse = self._answer(_STUBS["tiles"], "FindMapPoints", request)
        return answered

    def publish_map_file(self, version: str, description: str) -> operation_pb2.Operation:
        """See Transport."""
        request = map_file_pb2.PublishMapFileRequest(parent=version, map_descriptor=description)
        operation: operation_pb2.Operation = self._answer(_STUBS["files"], "PublishMapFile", request).operation
        return operation

    def enable_map_file(self, name: str) -> map_file_pb2.MapFile:
        """See Transport."""
        request = map_file_pb2.EnableMapFileRequest(name=name)
        enabled: map_file_pb2.MapFile = self._answer(_STUBS["files"], "EnableMapFile", request).map_file
        return enabled

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """See Transport."""
        request = map_file_pb2.DownloadMapFileRequest(name=name, offset=offset)
        call = self._method(_STUBS["files"], "DownloadMapFile")(request, metadata=self._metadata)
        try:
            for chunk in Answers(call).all(SILENT_S):
                if chunk.data:
                    yield chunk.data
        except (grpc.RpcError, LostCall) as error:
            raise _api_error(error, self._address) from error
        finally:
            call.cancel()

    def search(self, request: loop_closure_pb2.SearchSubmapsRequest) -> loop_closure_pb2.SearchSubmapsResponse:
        """See Transport."""
        stub = _STUBS["loopClosures"]
        answered: loop_closure_pb2.SearchSubmapsResponse = self._answer(stub, "SearchSubmaps", request)
        return answered

    def localize(self, request: loop_closure_pb2.LocalizeRequest) -> loop_closure_pb2.LocalizeResponse:
        """See Transport."""
        answered: loop_closure_pb2.LocalizeResponse = self._answer(_STUBS["loopClosures"], "Localize", request)
        return answered

    def create_webhook(self, request: webhook_pb2.CreateWebhookRequest) -> webhook_pb2.CreateWebhookResponse:
        """See Transport."""
        answered: webhook_pb2.CreateWebhookResponse = self._answer(_STUBS["webhooks"], "CreateWebhook", request)
        return answered

    def resume_webhook(self, name: str) -> webhook_pb2.Webhook:
        """See Transport."""
        request = webhook_pb2.ResumeWebhookRequest(name=name)
        resumed: webhook_pb2.Webhook = self._answer(_STUBS["webhooks"], "ResumeWebhook", request).webhook
        return resumed

    def webhook_deliveries(self, name: str) -> Iterator[webhook_pb2.WebhookDelivery]:
        """See Transport."""
        request = webhook_pb2.ListWebhookDeliveriesRequest(parent=name)
        while True:
            page = self._answer(_STUBS["webhooks"], "ListWebhookDeliveries", request)
            yield from page.webhook_deliveries
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def propose_loop(
        self, request: loop_closure_pb2.CreateLoopClosureRequest
    ) -> loop_closure_pb2.CreateLoopClosureResponse:
        """See Transport."""
        stub = _STUBS["loopClosures"]
        answered: loop_closure_pb2.CreateLoopClosureResponse = self._answer(stub, "CreateLoopClosure", request)
        return answered

    def decide_loop(self, decision: str, name: str, note: str) -> loop_closure_pb2.LoopClosure:
        """See Transport."""
        method = f"{decision.capitalize()}LoopClosure"
        request = getattr(loop_closure_pb2, f"{method}Request")(name=name, note=note)
        changed: loop_closure_pb2.LoopClosure = self._answer(_STUBS["loopClosures"], method, request).loop_closure
        return changed

    def loop_keypoints(self, name: str) -> loop_closure_pb2.GetLoopClosureKeypointsResponse:
        """See Transport."""
        request = loop_closure_pb2.GetLoopClosureKeypointsRequest(name=name)
        found: loop_closure_pb2.GetLoopClosureKeypointsResponse = self._answer(
            _STUBS["loopClosures"], "GetLoopClosureKeypoints", request
        )
        return found

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """See Transport."""
        call = self._method(event_pb2_grpc.EventServiceStub, "WatchEvents")(request, metadata=self._metadata)
        try:
            for response in Answers(call).all(SILENT_S):
                yield response.event if response.HasField("event") else None
        except (grpc.RpcError, LostCall) as error:
            raise _api_error(error, self._address) from error
        finally:
            call.cancel()

    def optimise_map(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        answered = self._answer(_STUBS["versions"], "OptimiseMap", mapping_pb2.OptimiseMapRequest(name=name))
        operation: operation_pb2.Operation = answered.operation
        return operation

    def revert_map(self, name: str, version: int) -> mapping_pb2.MapVersion:
        """See Transport."""
        request = request_of(mapping_pb2.RevertMapRequest, {"name": name, "version": version})
        restored: mapping_pb2.MapVersion = self._answer(_STUBS["versions"], "RevertMap", request).map_version
        return restored

    def merge_map(self, request: mapping_pb2.MergeMapRequest) -> operation_pb2.Operation:
        """See Transport."""
        operation: operation_pb2.Operation = self._answer(_STUBS["merges"], "MergeMap", request).operation
        return operation

    def revert_merge(self, name: str) -> mapping_pb2.MapMerge:
        """See Transport."""
        request = mapping_pb2.RevertMapMergeRequest(name=name)
        reverted: mapping_pb2.MapMerge = self._answer(_STUBS["merges"], "RevertMapMerge", request).map_merge
        return reverted

    def cancel_operation(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        request = operation_pb2.CancelOperationRequest(name=name)
        operation: operation_pb2.Operation = self._answer(_STUBS["operations"], "CancelOperation", request).operation
        return operation

    def correction(self, session: str) -> mapping_pb2.Correction:
        """See Transport."""
        request = mapping_pb2.GetCorrectionRequest(name=session)
        found: mapping_pb2.Correction = self._answer(_STUBS["versions"], "GetCorrection", request).correction
        return found

    def corrections(self, map_name: str, session: str, after: int) -> GrpcCorrectionFeed:
        """See Transport."""
        request = mapping_pb2.WatchCorrectionsRequest(parent=map_name, session=session, after=after)
        call = self._method(_STUBS["versions"], "WatchCorrections")(request, metadata=self._metadata)
        return GrpcCorrectionFeed(call, lambda error: _api_error(error, self._address))

    def status(self) -> system_pb2.GetStatusResponse:
        """See Transport."""
        stub, request = system_pb2_grpc.SystemServiceStub, system_pb2.GetStatusRequest()
        answered: system_pb2.GetStatusResponse = self._answer(stub, "GetStatus", request)
        return answered

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> GrpcScanSink:
        """See Transport."""
        return GrpcScanSink(
            self._stream_scans(), session, self._retry, lambda error: _api_error(error, self._address), journal
        )

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """See Transport."""
        return self._run(lambda: holds_scan(self._stream_scans(), session, seq, cloud, pose, stamp_ns))

    def close(self) -> None:
        """See Transport."""
        self._channel.close()

    def _stream_scans(self) -> Callable[..., Any]:
        return partial(self._method(ingest_pb2_grpc.IngestServiceStub, "StreamScans"), metadata=self._metadata)

    def _method(self, stub: Any, name: str) -> Callable[..., Any]:
        method: Callable[..., Any] = getattr(stub(self._channel), name)
        return method

    def _resource(self, collection: str, verb: str, request: Any) -> Any:
        answered = self._answer(_STUBS[collection], f"{verb}{_noun(collection)}", request)
        return getattr(answered, COLLECTIONS[collection].field)

    def _answer(self, stub: Any, method: str, request: Any) -> Any:
        called = self._method(stub, method)
        return self._run(lambda: answer(called, request, ANSWER_TIMEOUT_S, self._metadata))

    def _run(self, call: Callable[[], T]) -> T:
        def once() -> T:
            try:
                return call()
            except (grpc.RpcError, LostCall) as error:
                raise _api_error(error, self._address) from error

        return self._retry.run(once)


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


def _channel_credentials(credentials: Credentials) -> grpc.ChannelCredentials:
    credentials.ssl_context()  # refuses files that gRPC would only log
    files = (credentials.ca, credentials.key, credentials.certificate)
    return grpc.ssl_channel_credentials(*(None if file is None else file.read_bytes() for file in files))


def _noun(collection: str) -> str:
    """`Map` of `maps`, as it is part of the names of methods and messages."""
    return COLLECTIONS[collection].resource.DESCRIPTOR.name


def _request(verb: str, collection: str, fields: dict[str, Any]) -> Any:
    return getattr(_MODULES[collection], f"{verb}{_noun(collection)}Request")(**fields)


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
