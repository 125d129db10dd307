"""HTTP as such: problem+json, strict JSON, body limits, encodings, headers, odd requests (rows H, I, J)."""

from __future__ import annotations

import gzip
import json
import re
import socket

import httpx
import pytest
import zstandard

from revisit.core.errors import ErrorCode
from revisit.formats import QUANTISED, encode_quantised
from revisit.service.rest.routes.page import WEB
from revisit.service.status import STATUS
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points

MIB = 2**20
CLOUD = encode_quantised(cloud_points(1))
POSE = "0,0,0,0,0,0,1"


@pytest.fixture
def http(service):
    with httpx.Client(base_url=service.http, trust_env=False) as client:
        yield client


@pytest.fixture
def submaps(http, request):
    """The path of a new session's submaps."""
    number = abs(hash(request.node.nodeid)) % 10**12
    assert http.post("/v1/maps", json={"map_id": f"h{number}"}).status_code == 201
    assert http.post(f"/v1/maps/h{number}/sessions", json={"session_id": "s"}).status_code == 201
    return f"/v1/maps/h{number}/sessions/s/submaps"


def post_cloud(http, path, content=CLOUD, headers=None, **params):
    query = {"submap_id": "a", "stamp_ns": 1, "T_odom_submap": POSE, **params}
    return http.post(path, params=query, content=content, headers={"content-type": QUANTISED, **(headers or {})})


def assert_problem(answer, status, reason):
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    body = answer.json()
    assert body["reason"] == reason
    assert body["type"] == f"urn:revisit:error:{reason.lower()}"
    assert body["status"] == status
    assert body["code"] == STATUS[ErrorCode(reason)].grpc
    assert body["retryable"] is STATUS[ErrorCode(reason)].retryable
    assert body["request_id"] == answer.headers["x-request-id"]
    assert {"title", "detail"} <= body.keys()
    assert len(answer.content) <= 4096
    return body


def test_a_create_and_its_replay_answer_alike_and_the_replay_says_so(http, submaps):
    first, again = post_cloud(http, submaps), post_cloud(http, submaps)
    assert (first.status_code, again.status_code) == (202, 202)
    assert "idempotent-replay" not in first.headers
    assert again.headers["idempotent-replay"] == "true"
    assert again.json()["submap"]["name"] == first.json()["submap"]["name"]
    assert first.json()["report"] == {"dropped_nonfinite": 0, "degenerate_plane": False}


STRANGE_JSON = {
    "200,000 brackets": (b"[" * 200_000, 413),
    "16,000 brackets": (b"[" * 16_000, 400),
    "300 arrays side by side": (b"[" + b"[]," * 300 + b"[]]", 400),
    "an array": (b"[]", 422),
    "nothing": (b"", 400),
    "more keys than any call has": (json.dumps({"map_id": "x", **{f"f{n}": n for n in range(64)}}).encode(), 400),
    "60 wrong items": (json.dumps({"map_id": "x", **{f"f{n}": n for n in range(60)}}).encode(), 422),
    "an unknown rule for loops": (b'{"map_id": "x", "loop_policy": {"min_scor": 0.5}}', 422),
    "a rule for loops out of bounds": (b'{"map_id": "x", "loop_policy": {"min_score": 1.5}}', 422),
    "control characters in a label": (b'{"map_id": "x", "display_name": "a\\r\\n\\u001b[31m"}', 422),
}
"""What tests/corpus has not in its rows J."""


@pytest.mark.parametrize("case", STRANGE_JSON)
def test_strange_json_is_refused_and_nothing_is_stored(case, http, service):
    body, status = STRANGE_JSON[case]
    before = service.stored()
    answer = http.post("/v1/maps", content=body, headers={"content-type": "application/json"})
    assert_problem(answer, status, {400: "MALFORMED_BODY", 413: "TOO_LARGE"}.get(status, "BAD_FIELD"))
    assert service.stored() == before


def test_brackets_inside_strings_do_not_count_as_depth(http):
    name = "[" * 100 + '\\"' + "{" * 50
    body = f'{{"map_id": "brackets", "display_name": "{name}"}}'.encode()
    assert http.post("/v1/maps", content=body, headers={"content-type": "application/json"}).status_code == 201


@pytest.mark.parametrize("content_type", ["text/plain", "multipart/form-data; boundary=x", ""])
def test_json_of_another_content_type_is_refused(content_type, http):
    answer = http.post("/v1/maps", content=b'{"map_id": "x"}', headers={"content-type": content_type})
    assert_problem(answer, 415, "UNSUPPORTED_ENCODING")


def test_a_declared_length_over_the_limit_is_refused_before_it_is_read(service):
    host, port = service.http.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
        head = f"POST /v1/maps HTTP/1.1\r\nHost: {host}\r\nContent-Length: {300 * MIB}\r\n\r\n"
        connection.sendall(head.encode())
        assert connection.recv(4096).startswith(b"HTTP/1.1 413 ")


def test_a_chunked_body_is_refused_at_the_limit(http, submaps, service):
    def chunks():
        for _ in range(33):
            yield bytes(MIB)

    before = service.stored()
    assert_problem(post_cloud(http, submaps, content=chunks()), 413, "TOO_LARGE")
    assert service.stored() == before


@pytest.mark.parametrize("compress", [gzip.compress, zstandard.compress])
def test_a_compressed_cloud_is_the_same_cloud(compress, http, submaps):
    encoding = {"content-encoding": "gzip" if compress is gzip.compress else "zstd"}
    answer = post_cloud(http, submaps, content=compress(CLOUD), headers=encoding)
    assert (answer.status_code, answer.json()["submap"]["point_count"]) == (202, 300)
    assert post_cloud(http, submaps).headers["idempotent-replay"] == "true"


@pytest.mark.parametrize(
    ("encoding", "content", "status", "reason"),
    [
        ("gzip", gzip.compress(bytes(100 * MIB), 9), 413, "TOO_LARGE"),
        ("zstd", zstandard.compress(bytes(100 * MIB)), 413, "TOO_LARGE"),
        ("gzip", gzip.compress(CLOUD)[:-5], 400, "MALFORMED_BODY"),
        ("zstd", zstandard.compress(CLOUD)[:-5], 400, "MALFORMED_BODY"),
        ("gzip", gzip.compress(CLOUD) * 2, 400, "MALFORMED_BODY"),
        ("gzip, gzip", gzip.compress(gzip.compress(CLOUD)), 415, "UNSUPPORTED_ENCODING"),
        ("br", CLOUD, 415, "UNSUPPORTED_ENCODING"),
    ],
)
def test_a_bomb_or_a_damaged_encoding_is_refused(encoding, content, status, reason, http, submaps, service):
    before = service.stored()
    answer = post_cloud(http, submaps, content=content, headers={"content-encoding": encoding})
    assert_problem(answer, status, reason)
    assert service.stored() == before


BAD_POSES = [
    "",
    "0,0,0,0,0,0",
    "0,0,0,0,0,0,1,1",
    "a,0,0,0,0,0,1",
    "nan,0,0,0,0,0,1",
    "1e400,0,0,0,0,0,1",
    "1_0,0,0,0,0,0,1",
]


@pytest.mark.parametrize("text", BAD_POSES)
def test_a_pose_that_is_not_seven_numbers_is_refused(text, http, submaps):
    assert_problem(post_cloud(http, submaps, T_odom_submap=text), 422, "BAD_FIELD")


def test_the_pose_may_come_as_a_header_but_not_twice(http, submaps):
    query = {"submap_id": "b", "stamp_ns": 1}
    headers = {"content-type": QUANTISED, "t-odom-submap": "1,2,3,0,0,0,1"}
    answer = http.post(submaps, params=query, content=CLOUD, headers=headers)
    assert answer.json()["submap"]["t_odom_submap"]["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert_problem(post_cloud(http, submaps, headers=headers), 422, "BAD_FIELD")


@pytest.mark.parametrize(
    ("params", "field"),
    [
        ({"stamp_ns": -1}, "stamp_ns"),
        ({"stamp_ns": 2**63}, "stamp_ns"),
        ({"stamp_ns": "nan"}, "stamp_ns"),
        ({"submap_id": "x" * 65}, "submap_id"),
    ],
)
def test_a_bad_parameter_is_named(params, field, http, submaps):
    assert assert_problem(post_cloud(http, submaps, **params), 422, "BAD_FIELD")["field"] == field


@pytest.mark.parametrize("k", ["0", "-1", "101", "2000000000", "100000000000000000000", "1.5", "x"])
def test_k_is_a_whole_number_from_1_to_100(k, http, submaps):
    path = submaps.partition("/sessions/")[0] + "/submaps:search"
    answer = http.post(path, params={"k": k}, content=CLOUD, headers={"content-type": QUANTISED})
    assert_problem(answer, 422, "BAD_FIELD")


@pytest.mark.parametrize(
    "path", ["/nowhere", "/v1/maps/..%2f..%2fetc%2fpasswd", "/v1/maps/%2e%2e", "/v1/maps/%ff", "/v1/maps/a%00b"]
)
def test_a_path_that_leads_nowhere_is_not_found(path, http):
    assert_problem(http.get(path), 404, "NOT_FOUND")


@pytest.mark.parametrize(("method", "path"), [("PUT", "/v1/maps"), ("TRACE", "/livez"), ("PATCH", "/v1/maps/x")])
def test_a_method_a_path_does_not_take_is_named_as_such(method, path, http):
    answer = http.request(method, path, headers={"x-http-method-override": "GET"})
    assert_problem(answer, 405, "METHOD_NOT_ALLOWED")


def test_every_answer_carries_security_headers_and_a_request_id(http):
    for path in ("/", "/livez", "/v1/maps", "/nowhere"):
        headers = http.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-frame-options"] == "DENY"
        assert "server" not in headers
        assert len(headers["x-request-id"]) == 32


def test_the_request_id_of_a_client_is_kept_only_where_it_is_harmless(http):
    assert http.get("/livez", headers={"x-request-id": "job-7.a"}).headers["x-request-id"] == "job-7.a"
    assert http.get("/livez", headers={"x-request-id": "x" * 65}).headers["x-request-id"] != "x" * 65
    assert http.get("/livez", headers={"x-request-id": "<b>"}).headers["x-request-id"] != "<b>"


def test_a_page_of_another_origin_can_change_nothing(http, submaps, service):
    before = service.stored()
    for origin in ("https://evil.example", "null"):
        answer = http.post(submaps.replace("/submaps", ":finish"), headers={"origin": origin})
        assert_problem(answer, 403, "PERMISSION_DENIED")
    assert (
        http.get("/v1/maps", headers={"origin": "https://evil.example"}).headers.get("access-control-allow-origin")
        is None
    )
    assert service.stored() == before
    own = {"origin": service.http}
    assert http.post(submaps.replace("/submaps", ":finish"), headers=own).json()["state"] == "FINISHED"


def test_a_draining_service_is_not_ready(http, service):
    stopping = service.world.context.stopping
    stopping.set()
    try:
        ready = http.get("/readyz")
    finally:
        stopping.clear()
    assert (ready.status_code, ready.json()) == (503, {"ready": False, "reasons": ["draining"], "degraded": []})
    assert http.get("/readyz").json()["ready"] is True


def test_a_service_without_a_living_worker_says_so(http, service):
    transactions = service.world.context.transactions
    (degraded,) = http.get("/readyz").json()["degraded"]
    assert degraded.startswith("no worker is ready") and "compiles its kernels" in degraded
    transactions.write(lambda uow: uow.workers.beat("w1", "fake-1")).result()
    try:
        assert http.get("/readyz").json() == {"ready": True, "reasons": [], "degraded": []}
    finally:
        transactions.write(lambda uow: uow.workers.forget("w1")).result()


def test_health_version_and_status_answer(http):
    assert http.get("/livez").json() == {"status": "ok"}
    assert http.get("/version").json()["version"] == "test"
    assert http.get("/v1/status").json()["failed_jobs"] >= 0


def test_the_page_is_served_with_its_scripts_and_style_and_nothing_inline(http):
    page = http.get("/")
    assert page.headers["content-type"].startswith("text/html")
    for source in ("/page.js", "/page.css", "/theme.js", "/mark.svg"):
        assert source in page.text
        assert http.get(source).status_code == 200
    assert "<script>" not in page.text
    assert "style=" not in page.text
    assert "onclick" not in page.text
    for script in WEB.glob("*.js"):
        served = http.get(f"/{script.name}")
        assert served.status_code == 200, script.name
        assert served.headers["content-type"].startswith("text/javascript")
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|eval\(", served.text)
    assert http.get("/settings.js").status_code == 404


def test_what_the_page_needs_of_others_comes_from_the_service_and_may_be_kept(http):
    imports = re.compile("""(?:from |src=|href=)["'](/[^"']+)["']""")
    named = {path for file in WEB.glob("*.*") for path in imports.findall(file.read_text())}
    for path in sorted(named):
        assert http.get(path).status_code == 200, path
    three = http.get("/vendor/three-0.187.0/three.module.js")
    assert three.headers["cache-control"] == "public, max-age=86400, immutable"
    assert http.get("/page.js").headers["cache-control"] == "no-store"


def test_a_pose_that_is_not_one_is_refused_with_the_order_of_its_numbers(http, submaps):
    asked = {"submap_id": "p", "stamp_ns": 1, "T_odom_submap": "0,0,0,1"}
    headers = {"content-type": QUANTISED}
    few = http.post(submaps, params=asked, content=encode_quantised(cloud_points(1)), headers=headers)
    assert "x,y,z,qx,qy,qz,qw" in few.json()["detail"]
    long = http.post(submaps, params={**asked, "T_odom_submap": "0,0,0,1,1,0,1"}, content=b"", headers=headers)
    assert "w is the last" in long.json()["detail"]
