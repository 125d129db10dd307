"""The SDK over REST."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx

from revisit.sdk.clouds import Cloud
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError, ErrorDetails, error_of, unreachable
from revisit.sdk.resources import Json
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import Forgetful, StreamJournal

CONNECT_TIMEOUT_S = 5.0
ANSWER_TIMEOUT_S = 90.0


class RestTransport:
    """`revisit.sdk.transport.Transport` over HTTP."""

    def __init__(self, base_url: str, retry: RetryPolicy, credentials: Credentials = Credentials()) -> None:
        timeout = httpx.Timeout(ANSWER_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        # trust_env: a robot's proxy settings must not send its clouds elsewhere.
        self._http = httpx.Client(
            base_url=base_url,
            timeout=timeout,
            trust_env=False,
            headers=credentials.authorization(),
            verify=credentials.ssl_context() if base_url.startswith("https:") else True,
        )
        self._base_url = base_url
        self._retry = retry

    def create(self, parent: str, collection: str, resource_id: str, fields: Json) -> Json:
        """See Transport."""
        singular = collection.removesuffix("s")
        body = {f"{singular}_id": resource_id, **fields}
        if "robot" in body:
            body["robot_id"] = body.pop("robot").removeprefix("robots/")
        return self._json("POST", _path(parent, collection), json=body)

    def get(self, name: str, *, full: bool = False) -> Json:
        """See Transport."""
        return self._json("GET", _path(name), params={"view": "FULL"} if full else {})

    def list(self, parent: str, collection: str, filters: Json) -> Iterator[Json]:
        """See Transport."""
        if "session" in filters:
            filters = {**filters, "session_id": _last(filters["session"])}
            del filters["session"]
        token = ""
        while True:
            page = self._json("GET", _path(parent, collection), params={**filters, "page_token": token})
            yield from page[_snake(collection)]
            token = page["next_page_token"]
            if not token:
                return

    def delete(self, name: str) -> None:
        """See Transport."""
        self._send("DELETE", _path(name))

    def finish_session(self, name: str) -> Json:
        """See Transport."""
        return self._json("POST", f"{_path(name)}:finish")

    def wait_operation(self, name: str, timeout_s: float) -> Json:
        """See Transport."""
        return self._json("GET", f"{_path(name)}:wait", params={"timeout_s": timeout_s})

    def retry_operation(self, name: str) -> Json:
        """See Transport."""
        return self._json("POST", f"{_path(name)}:retry")

    def post_submap(self, session: str, submap_id: str, pose: Json, stamp_ns: int, cloud: Cloud) -> Json:
        """See Transport."""
        params = {"submap_id": submap_id, "stamp_ns": stamp_ns, "T_odom_submap": _pose_text(pose)}
        return self._cloud(_path(session, "submaps"), cloud, params)

    def append_scan(self, session: str, seq: int, pose: Json, stamp_ns: int, cloud: Cloud) -> Json:
        """Append one scan; answers an acknowledgement."""
        params = {"seq": seq, "stamp_ns": stamp_ns, "T_odom_sensor": _pose_text(pose)}
        return self._cloud(_path(session, "scans"), cloud, params)

    def download(self, submap: str, file_format: str) -> bytes:
        """See Transport."""
        return self._send("GET", f"{_path(submap)}:download", params={"format": file_format}).content

    def search(self, map_name: str, query: Any, criteria: Json) -> Json:
        """See Transport."""
        path = _path(map_name, "submaps:search")
        for field in ("exclude_session", "only_session"):
            if field in criteria:
                criteria = {**criteria, field: _last(criteria[field])}
        if isinstance(query, Cloud):
            return self._cloud(path, query, _with_prior_text(criteria))
        if isinstance(query, str):
            return self._json("POST", path, json={"submap": query, **criteria})
        named = {"descriptor": query["vector"], "model_version": query["model_version"]}
        return self._json("POST", path, json={**named, **criteria})

    def localize(self, map_name: str, cloud: Cloud, options: Json) -> Json:
        """See Transport."""
        return self._cloud(f"{_path(map_name)}:localize", cloud, _with_prior_text(options))

    def status(self) -> Json:
        """See Transport."""
        return self._json("GET", "/v1/status")

    def open_stream(self, session: str, journal: StreamJournal = Forgetful()) -> RestScanSink:
        """See Transport."""
        return RestScanSink(self, session, journal)

    def close(self) -> None:
        """See Transport."""
        self._http.close()

    def _cloud(self, path: str, cloud: Cloud, params: Json) -> Json:
        headers = {"content-type": cloud.content_type}
        return self._json("POST", path, content=cloud.data, params=params, headers=headers)

    def _json(self, method: str, path: str, **request: Any) -> Json:
        answer: Json = self._send(method, path, **request).json()
        return answer

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
        self._committed_seq = int(transport.get(session)["committed_seq"])
        journal.opened(self._committed_seq, "")
        self.submaps: list[str] = []
        self.submap_seq = 0
        self.rejected: list[tuple[int, str]] = []

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
            if error.code != "INVALID_ARGUMENT" and error.reason != "TOO_LARGE":
                raise
            self._journal.refused(seq, error.reason, error.message)
            self.rejected.append((seq, error.reason))
            return
        self._committed_seq = int(ack["committed_seq"])
        self._journal.committed(self._committed_seq)
        if ack["submap"]:
            self.submaps.append(ack["submap"]["submap"]["name"])
            self.submap_seq = int(ack["submap"]["submap"]["seq"])

    def check(self) -> None:
        """See ScanSink: there is no connection that could end."""

    def flush(self) -> None:
        """See ScanSink: every `send` waited for its answer."""

    def close(self) -> None:
        """See ScanSink: the connection is the transport's."""


def _details(answer: httpx.Response) -> ErrorDetails:
    try:
        problem = answer.json()
        return ErrorDetails(
            code=problem["code"],
            reason=problem["reason"],
            message=problem["detail"],
            retryable=bool(problem["retryable"]),
            request_id=problem["request_id"],
            field=problem.get("field"),
            retry_after_s=float(answer.headers["retry-after"]) if "retry-after" in answer.headers else None,
            expected_seq=problem.get("expected_seq"),
        )
    except (ValueError, KeyError, TypeError):
        # Not our service's answer: a proxy's page, for example.
        unavailable = answer.status_code in (502, 503, 504)
        code = "UNAVAILABLE" if unavailable else "UNKNOWN"
        return ErrorDetails(code, "FOREIGN_ANSWER", f"HTTP {answer.status_code}", retryable=unavailable)


def _path(*parts: str) -> str:
    return "/v1/" + "/".join(part for part in parts if part)


def _last(name: str) -> str:
    return name.rpartition("/")[2]


def _snake(collection: str) -> str:
    return "loop_closures" if collection == "loopClosures" else collection


def _pose_text(pose: Json) -> str:
    translation, rotation = pose["translation"], pose["rotation"]
    return ",".join(repr(number) for number in [*translation.values(), *rotation.values()])


def _with_prior_text(options: Json) -> Json:
    if "prior_position_m" not in options:
        return options
    return {**options, "prior_position_m": ",".join(repr(float(number)) for number in options["prior_position_m"])}
