"""The SDK over REST."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import httpx
from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.message import Message

from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, FailedPrecondition, error_of, unreachable
from revisit.sdk.http_calls import HttpCalls
from revisit.sdk.json_answers import message_of
from revisit.sdk.messages import COLLECTIONS, cloud_message, collection_of
from revisit.sdk.resources import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import SILENT_S, Forgetful, Refusal, StreamJournal
from revisit.v1 import (
    cloud_pb2,
    event_pb2,
    geometry_pb2,
    ingest_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
    webhook_pb2,
)

M = TypeVar("M", bound=Message)

CONNECT_TIMEOUT_S = 5.0
ALREADY_EXISTS = "ALREADY_EXISTS"
"""The reason of a refusal: the number is taken by another scan."""

POLL_S = 0.5
"""How often a feed asks whether there is something new."""

ANSWER_TIMEOUT_S = 90.0


class RestTransport:
    """`revisit.sdk.transport.Transport` over HTTP."""

    def __init__(self, base_url: str, retry: RetryPolicy, credentials: Credentials = Credentials()) -> None:
        timeout = httpx.Timeout(ANSWER_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        verify = credentials.ssl_context() if base_url.startswith("https:") else True
        self._http = HttpCalls(base_url, timeout, credentials.authorization(), verify)
        self._base_url = base_url
        self._retry = retry

    def create(self, collection: str, request: Any) -> Any:
        """See Transport."""
        body = plain(request)
        path = _path(body.pop("parent", ""), collection)
        if "robot" in body:
            body["robot_id"] = _last(body.pop("robot"))
        return self._message(COLLECTIONS[collection].resource, "POST", path, json=body)

    def get(self, name: str, *, full: bool = False) -> Any:
        """See Transport."""
        kind = COLLECTIONS[collection_of(name)].resource
        return self._message(kind, "GET", _path(name), params={"view": "FULL"} if full else {})

    def list(self, collection: str, request: Any) -> Iterator[Any]:
        """See Transport."""
        params = plain(request)
        path = _path(params.pop("parent", ""), collection)
        if "session" in params:
            params["session_id"] = _last(params.pop("session"))
        while True:
            page: Any = self._message(COLLECTIONS[collection].page, "GET", path, params=params)
            yield from getattr(page, f"{COLLECTIONS[collection].field}s")
            if not page.next_page_token:
                return
            params["page_token"] = page.next_page_token

    def delete(self, name: str) -> None:
        """See Transport."""
        self._send("DELETE", _path(name))

    def finish_session(self, name: str) -> session_pb2.Session:
        """See Transport."""
        return self._message(session_pb2.Session, "POST", f"{_path(name)}:finish")

    def wait_operation(self, name: str, timeout_s: float) -> operation_pb2.Operation:
        """See Transport."""
        return self._message(operation_pb2.Operation, "GET", f"{_path(name)}:wait", params={"timeout_s": timeout_s})

    def retry_operation(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        return self._message(operation_pb2.Operation, "POST", f"{_path(name)}:retry")

    def post_submap(self, request: submap_pb2.PostSubmapRequest) -> submap_pb2.PostSubmapResponse:
        """See Transport."""
        pose = _pose_text(request.t_odom_submap)
        params = {"submap_id": request.submap_id, "stamp_ns": request.stamp_ns, "T_odom_submap": pose}
        path = _path(request.parent, "submaps")
        return self._message(submap_pb2.PostSubmapResponse, "POST", path, **_cloud(request.cloud, params))

    def append_scan(
        self, session: str, seq: int, pose: Json, stamp_ns: int, cloud: Cloud
    ) -> ingest_pb2.AppendScanResponse:
        """Append one scan."""
        transform = ParseDict(pose, geometry_pb2.Transform())
        params = {"seq": seq, "stamp_ns": stamp_ns, "T_odom_sensor": _pose_text(transform)}
        sent = _cloud(cloud_message(cloud), params)
        return self._message(ingest_pb2.AppendScanResponse, "POST", _path(session, "scans"), **sent)

    def download(self, submap: str, file_format: str) -> bytes:
        """See Transport."""
        return self._send("GET", f"{_path(submap)}:download", params={"format": file_format}).content

    def download_tile(self, tile: str, file_format: str) -> bytes:
        """See Transport."""
        return self._send("GET", f"{_path(tile)}:download", params={"format": file_format}).content

    def measure_distances(
        self, request: map_tile_pb2.MeasureMapDistancesRequest
    ) -> map_tile_pb2.MeasureMapDistancesResponse:
        """See Transport."""
        points = [coordinate for one in request.points_m for coordinate in (one.x, one.y, one.z)]
        body = {"points_m": points, "frame": request.frame}
        path = f"{_path(request.parent)}:distances"
        return self._message(map_tile_pb2.MeasureMapDistancesResponse, "POST", path, json=body)

    def find_points(self, request: map_tile_pb2.FindMapPointsRequest) -> map_tile_pb2.FindMapPointsResponse:
        """See Transport."""
        centre = request.centre_m
        params = {"centre_m": f"{centre.x!r},{centre.y!r},{centre.z!r}", "within_m": request.within_m}
        asked = {**params, "frame": request.frame, "limit": request.limit}
        path = f"{_path(request.parent)}/points"
        return self._message(map_tile_pb2.FindMapPointsResponse, "GET", path, params=asked)

    def publish_map_file(self, version: str, description: str) -> operation_pb2.Operation:
        """See Transport."""
        body = {"map_descriptor": description}
        return self._message(operation_pb2.Operation, "POST", f"{_path(version)}:publish", json=body)

    def enable_map_file(self, name: str) -> map_file_pb2.MapFile:
        """See Transport."""
        return self._message(map_file_pb2.MapFile, "POST", f"{_path(name)}:enable")

    def map_file_bytes(self, name: str, offset: int) -> Iterator[bytes]:
        """See Transport."""
        headers = {"range": f"bytes={offset}-"} if offset else {}
        try:
            with self._http.client.stream("GET", f"{_path(name)}:download", headers=headers) as answered:
                if not answered.is_success:
                    answered.read()
                    raise error_of(_details(answered))
                yield from answered.iter_bytes()
        except httpx.TransportError as error:
            raise unreachable(self._base_url, error) from error

    def search(self, request: loop_closure_pb2.SearchSubmapsRequest) -> loop_closure_pb2.SearchSubmapsResponse:
        """See Transport."""
        kind, path = loop_closure_pb2.SearchSubmapsResponse, _path(request.parent, "submaps:search")
        criteria = _criteria(request)
        if request.WhichOneof("query") == "cloud":
            return self._message(kind, "POST", path, **_cloud(request.cloud, _with_prior_text(criteria)))
        if request.WhichOneof("query") == "place_descriptor":
            criteria["descriptor"] = list(request.place_descriptor.vector)
            criteria["model_version"] = request.place_descriptor.model_version
        return self._message(kind, "POST", path, json=criteria)

    def localize(self, request: loop_closure_pb2.LocalizeRequest) -> loop_closure_pb2.LocalizeResponse:
        """See Transport."""
        sent = _cloud(request.cloud, _with_prior_text(_criteria(request)))
        path = f"{_path(request.parent)}:localize"
        return self._message(loop_closure_pb2.LocalizeResponse, "POST", path, **sent)

    def create_webhook(self, request: webhook_pb2.CreateWebhookRequest) -> webhook_pb2.CreateWebhookResponse:
        """See Transport."""
        body = {"webhook_id": request.webhook_id, "url": request.url, "kinds": _kind_names(request.kinds)}
        if request.map:
            body["map_id"] = _last(request.map)
        return self._message(webhook_pb2.CreateWebhookResponse, "POST", "/v1/webhooks", json=body)

    def resume_webhook(self, name: str) -> webhook_pb2.Webhook:
        """See Transport."""
        return self._message(webhook_pb2.Webhook, "POST", f"{_path(name)}:resume")

    def webhook_deliveries(self, name: str) -> Iterator[webhook_pb2.WebhookDelivery]:
        """See Transport."""
        kind, params = webhook_pb2.ListWebhookDeliveriesResponse, {"page_token": ""}
        while True:
            page = self._message(kind, "GET", _path(name, "deliveries"), params=params)
            yield from page.webhook_deliveries
            if not page.next_page_token:
                return
            params["page_token"] = page.next_page_token

    def propose_loop(
        self, request: loop_closure_pb2.CreateLoopClosureRequest
    ) -> loop_closure_pb2.CreateLoopClosureResponse:
        """See Transport."""
        body = plain(request)
        path = _path(body.pop("parent"), "loopClosures")
        if body.pop("t_match_query", None) is not None:
            body["T_match_query"] = _pose_text(request.t_match_query)
        return self._message(loop_closure_pb2.CreateLoopClosureResponse, "POST", path, json=body)

    def decide_loop(self, decision: str, name: str, note: str) -> loop_closure_pb2.LoopClosure:
        """See Transport."""
        return self._message(loop_closure_pb2.LoopClosure, "POST", f"{_path(name)}:{decision}", json={"note": note})

    def loop_keypoints(self, name: str) -> loop_closure_pb2.GetLoopClosureKeypointsResponse:
        """See Transport."""
        return self._message(loop_closure_pb2.GetLoopClosureKeypointsResponse, "GET", f"{_path(name)}/keypoints")

    def watch(self, request: event_pb2.WatchEventsRequest) -> Iterator[event_pb2.Event | None]:
        """See Transport."""
        params: Json = {"kinds": _kind_names(request.kinds)}
        if request.HasField("after"):
            params["after"] = request.after
        path, timeout = _path(request.parent, "events"), httpx.Timeout(SILENT_S, connect=CONNECT_TIMEOUT_S)
        try:
            with self._http.client.stream("GET", path, params=params, timeout=timeout) as answered:
                if not answered.is_success:
                    answered.read()
                    raise error_of(_details(answered))
                yield from events_of(answered.iter_lines())
        except httpx.TransportError as error:
            raise unreachable(self._base_url, error) from error

    def optimise_map(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        return self._message(operation_pb2.Operation, "POST", f"{_path(name)}:optimise")

    def revert_map(self, name: str, version: int) -> mapping_pb2.MapVersion:
        """See Transport."""
        return self._message(mapping_pb2.MapVersion, "POST", f"{_path(name)}:revert", json={"version": version})

    def merge_map(self, request: mapping_pb2.MergeMapRequest) -> operation_pb2.Operation:
        """See Transport."""
        body = {"source": request.source, "validate_only": request.validate_only}
        if request.HasField("t_map_source"):
            body["T_map_source"] = _pose_text(request.t_map_source)
        if request.HasField("radius_m"):
            body["radius_m"] = request.radius_m
        return self._message(operation_pb2.Operation, "POST", f"{_path(request.name)}:merge", json=body)

    def revert_merge(self, name: str) -> mapping_pb2.MapMerge:
        """See Transport."""
        return self._message(mapping_pb2.MapMerge, "POST", f"{_path(name)}:revert")

    def cancel_operation(self, name: str) -> operation_pb2.Operation:
        """See Transport."""
        return self._message(operation_pb2.Operation, "POST", f"{_path(name)}:cancel")

    def correction(self, session: str) -> mapping_pb2.Correction:
        """See Transport."""
        return self._message(mapping_pb2.Correction, "GET", f"{_path(session)}:correction")

    def corrections(self, map_name: str, session: str, after: int) -> RestCorrectionFeed:
        """See Transport."""
        return RestCorrectionFeed(self, map_name, session, after)

    def status(self) -> system_pb2.GetStatusResponse:
        """See Transport."""
        return self._message(system_pb2.GetStatusResponse, "GET", "/v1/status")

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> RestScanSink:
        """See Transport."""
        return RestScanSink(self, session, journal)

    def holds_scan(self, session: str, seq: int, cloud: Cloud, pose: Json, stamp_ns: int) -> bool:
        """See Transport."""
        if int(self.get(session).committed_seq) < seq:
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

    def _message(self, kind: type[M], method: str, path: str, **request: Any) -> M:
        """The answer, which is the JSON of a message; fields of a newer service are ignored."""
        answered = self._send(method, path, **request)
        try:
            return message_of(kind, answered.json())
        except (ValueError, ParseError) as error:
            details = ErrorDetails("UNKNOWN", "FOREIGN_ANSWER", f"{path} was not answered by this service")
            raise error_of(details) from error

    def _send(self, method: str, path: str, **request: Any) -> httpx.Response:
        return self._retry.run(lambda: self._send_once(method, path, request))

    def _send_once(self, method: str, path: str, request: Json) -> httpx.Response:
        try:
            answer = self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise unreachable(self._base_url, error) from error
        if answer.is_success:
            return answer
        raise error_of(_details(answer))


class RestScanSink:
    """Scans one request each, for networks that only let HTTP through."""

    def __init__(self, transport: RestTransport, session: str, journal: StreamJournal) -> None:
        self._transport = transport
        self._session = session
        self._journal = journal
        self._committed_seq = int(transport.get(session).committed_seq)
        journal.opened(self._committed_seq, "")
        self.submaps: list[str] = []
        self.submap_seq = 0
        self.refusals: list[Refusal] = []

    @property
    def committed_seq(self) -> int:
        """The last scan that is stored durably."""
        return self._committed_seq

    def send(self, cloud: Cloud, pose: Json, stamp_ns: int) -> None:
        """See ScanSink."""
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
        self._journal.committed(self._committed_seq)
        if ack.HasField("submap"):
            self.submaps.append(ack.submap.submap.name)
            self.submap_seq = ack.submap.submap.seq

    def check(self) -> None:
        """See ScanSink: there is no connection that could end."""

    def flush(self) -> None:
        """See ScanSink: every `send` waited for its answer."""

    def close(self) -> None:
        """See ScanSink: the connection is the transport's."""


def _is_for_good(error: ApiError) -> bool:
    """Whether a scan is refused for what it is."""
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


def _kind_names(kinds: Iterable[Any]) -> list[str]:
    return [event_pb2.Event.Kind.Name(kind) for kind in kinds]


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

    def __init__(self, transport: RestTransport, map_name: str, session: str, after: int) -> None:
        self._transport = transport
        self._map_name = map_name
        self._session = session
        self._after = after
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
        current: map_pb2.Map = self._transport.get(self._map_name)
        if current.map_version <= self._after:
            return
        self._after = current.map_version
        asked = session_pb2.ListSessionsRequest(parent=self._map_name)
        sessions = [self._session] if self._session else self._transport.list("sessions", asked)
        for session in sessions:
            try:
                self._news.append(self._transport.correction(session if isinstance(session, str) else session.name))
            except FailedPrecondition:
                continue  # a session that came after the version

    def close(self) -> None:
        """See CorrectionFeed."""
        self._closed.set()


def _details(answer: httpx.Response) -> ErrorDetails:
    try:
        retry_after_s = float(answer.headers["retry-after"]) if "retry-after" in answer.headers else None
        return _problem_details(answer.json(), retry_after_s)
    except (ValueError, KeyError, TypeError):
        # Not our service's answer: a proxy's page, for example.
        unavailable = answer.status_code in (502, 503, 504)
        code = "UNAVAILABLE" if unavailable else "UNKNOWN"
        return ErrorDetails(code, "FOREIGN_ANSWER", f"HTTP {answer.status_code}", retryable=unavailable)


def _path(*parts: str) -> str:
    return "/v1/" + "/".join(part for part in parts if part)


def _last(name: str) -> str:
    return name.rpartition("/")[2]


def plain(message: Message) -> Json:
    """The fields of a message that are set, as the JSON that requests are: 64-bit integers are numbers there."""
    return {field.name: _plain_value(field, value) for field, value in message.ListFields()}


def _plain_value(field: Any, value: Any) -> Any:
    if field.is_repeated:
        return list(value)
    if field.message_type is not None:
        return plain(value)
    return value if field.enum_type is None else field.enum_type.values_by_number[value].name


def _criteria(request: Any) -> Json:
    """The fields of a query but for its map and its cloud or descriptor; sessions by id, the prior as numbers."""
    elsewhere = ("parent", "cloud", "place_descriptor")
    criteria = {name: value for name, value in plain(request).items() if name not in elsewhere}
    for name in ("exclude_session", "only_session"):
        if name in criteria:
            criteria[name] = _last(criteria[name])
    if "prior_position_m" in criteria:
        prior = request.prior_position_m
        criteria["prior_position_m"] = [prior.x, prior.y, prior.z]
    if criteria.pop("t_level_query", None) is not None:
        criteria["T_level_query"] = _pose_text(request.t_level_query)
    return criteria


def _with_prior_text(criteria: Json) -> Json:
    if "prior_position_m" not in criteria:
        return criteria
    return {**criteria, "prior_position_m": ",".join(repr(number) for number in criteria["prior_position_m"])}


def _cloud(cloud: cloud_pb2.Cloud, params: Json) -> Json:
    """What httpx sends for a cloud."""
    headers = {"content-type": cloud.encoded.content_type}
    return {"content": cloud.encoded.data, "params": params, "headers": headers}


def _pose_text(pose: geometry_pb2.Transform) -> str:
    t, q = pose.translation, pose.rotation
    return ",".join(repr(number) for number in (t.x, t.y, t.z, q.x, q.y, q.z, q.w))
