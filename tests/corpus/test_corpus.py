"""Every row of the corpus, sent to the running service over both transports, gets the documented answer."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from tests.corpus.rows import UNROTATED, Case, CloudToSend, cases
from tests.corpus.sending import (
    METHODS,
    Answer,
    ScanTalk,
    filled,
    grpc_cloud,
    grpc_request,
    raw_status,
    rest_cloud,
    rest_request,
)
from tests.corpus.write import body_of

CASES = cases()
PROBLEM_BYTES = 4096


def of(kind: str, transport: str) -> list[Any]:
    """The cases that send this over this transport."""
    return [pytest.param(case, id=case.id) for case in CASES if getattr(case, kind) and getattr(case, transport)]


def judge(case: Case, expected: tuple[Any, ...], answer: Answer) -> None:
    """Status, reason and the members that the case names."""
    status, reason = (*expected, "")[:2]
    assert (answer.status, answer.reason or "") == (status, _one_of(reason, answer.reason)), answer.body
    if isinstance(answer.status, int) and answer.status >= 400:
        assert answer.size <= PROBLEM_BYTES
    for path, value in case.has.items():
        assert any(_same(_member(answer.body, one), value) for one in path.split("|")), (path, answer.body)


def _one_of(reasons: str, actual: str) -> str:
    return actual if actual in reasons.split("|") else reasons


def _member(body: Any, path: str) -> Any:
    for name in path.split("."):
        body = body.get(name) if isinstance(body, dict) else None
    return body


def _same(actual: Any, expected: Any) -> bool:
    """Equal; protobuf's JSON writes 64-bit integers as text."""
    return actual == expected or (isinstance(expected, int) and str(actual) == str(expected))


def refused(case: Case, transport: str) -> bool:
    """Whether nothing may be stored."""
    status = getattr(case, transport)[0]
    return status != "OK" if isinstance(status, str) else status >= 400


@pytest.fixture
def unchanged(corpus_service):
    """Counts rows and blobs around what a test sends."""

    def check(case: Case, transport: str, send: Callable[[], Answer]) -> Answer:
        before = corpus_service.stored()
        answer = send()
        if refused(case, transport):
            assert corpus_service.stored() == before
        return answer

    return check


@pytest.mark.parametrize("case", of("clouds", "http"))
def test_a_cloud_over_rest(case, corpus_service, unchanged):
    path = f"/v1/{corpus_service.new_session()}/submaps"
    for number, cloud in enumerate(case.clouds):
        answer = unchanged(
            case, "http", partial(rest_cloud, corpus_service.http, path, cloud, submap_id=f"{case.id}-{number}")
        )
        judge(case, case.http, answer)


@pytest.mark.parametrize("case", of("clouds", "grpc"))
def test_a_cloud_over_grpc(case, corpus_service, unchanged):
    session = corpus_service.new_session()
    for number, cloud in enumerate(case.clouds):
        answer = unchanged(
            case, "grpc", partial(grpc_cloud, corpus_service.channel, session, cloud, f"{case.id}-{number}")
        )
        judge(case, case.grpc, answer)


@pytest.mark.parametrize("case", of("clouds", "grpc"))
def test_a_cloud_in_a_stream_and_the_stream_lives(case, corpus_service, unchanged):
    session = corpus_service.new_session()
    talk = ScanTalk(corpus_service.channel, session)
    seq = 1
    for cloud in case.clouds:
        answer = unchanged(case, "grpc", partial(talk.send, cloud, seq))
        if refused(case, "grpc"):
            assert (answer.status, answer.reason) == ("NACK", case.grpc[1]), answer.body
            assert (answer.body["retryable"], answer.body["expected_seq"]) == (False, str(seq))
        else:
            assert (answer.status, answer.body["committed_seq"]) == ("OK", str(seq)), answer.body
            seq += 1
    good = CloudToSend.read({"body": "good.rvq", "stamp_ns": 2 * 10**18})
    assert talk.send(good, seq).status == "OK"
    talk.end()


def scan_of(step: dict[str, Any]) -> CloudToSend:
    """A step of `scans`."""
    pose = (float(step.get("x", 0.0)), *UNROTATED[1:])
    stamp_ns = step.get("stamp_ns", 1)
    return CloudToSend.read({"body": step.get("body", "good.rvq"), "pose": pose, "stamp_ns": stamp_ns})


@pytest.mark.parametrize("case", of("scans", "http"))
def test_scans_over_rest(case, corpus_service, unchanged):
    path = f"/v1/{corpus_service.new_session()}/scans"
    *first, last = case.scans
    for step in first:
        assert rest_cloud(corpus_service.http, path, scan_of(step), seq=step["seq"]).status == 200
    answer = unchanged(case, "http", partial(rest_cloud, corpus_service.http, path, scan_of(last), seq=last["seq"]))
    judge(case, case.http, answer)
    assert answer.replay == last.get("replay", False)


@pytest.mark.parametrize("case", of("scans", "grpc"))
def test_scans_in_a_stream(case, corpus_service, unchanged):
    talk = ScanTalk(corpus_service.channel, corpus_service.new_session())
    *first, last = case.scans
    for step in first:
        assert talk.send(scan_of(step), int(step["seq"])).status == "OK"
    before = corpus_service.stored()
    answer = unchanged(case, "grpc", partial(talk.send, scan_of(last), int(last["seq"])))
    judge(case, ("NACK" if refused(case, "grpc") else "OK", *case.grpc[1:]), answer)
    if last.get("replay"):
        assert corpus_service.stored() == before
    talk.end()


@pytest.mark.parametrize("case", of("rest", "http"))
def test_a_request_over_rest(case, corpus_service, unchanged):
    places = corpus_service.places()
    for request in case.rest:
        answer = unchanged(case, "http", partial(rest_request, corpus_service.http, request, places))
        judge(case, case.http, answer)


@pytest.mark.parametrize("case", of("rpc", "grpc"))
def test_a_call_over_grpc(case, corpus_service, unchanged):
    places = corpus_service.places()
    for call in case.rpc:
        answer = unchanged(case, "grpc", partial(grpc_request, corpus_service.channel, call, places))
        judge(case, case.grpc, answer)


def raw_bytes(entry: Any) -> bytes:
    """An entry of `raw`: text, or a head followed by something many times over."""
    if isinstance(entry, str):
        return entry.encode("latin-1")
    head = bytes.fromhex(entry["hex"]) if "hex" in entry else entry["head"].encode("latin-1")
    return head + entry["repeat"].encode("latin-1") * entry["times"]


@pytest.mark.parametrize("case", of("raw", "answers"))
def test_bytes_on_a_connection(case, corpus_service):
    before = corpus_service.stored()
    for entry in case.raw:
        assert raw_status(corpus_service.live.http, raw_bytes(entry)) in case.answers, entry
        assert corpus_service.http.get("/livez").status_code == 200
    assert corpus_service.stored() == before


def names_that_requests_have(openapi: dict[str, Any]) -> set[str]:
    """Every parameter, header and member of a body of REST, and every field of a request message of gRPC."""
    found: set[str] = set()

    def members(schema: Any) -> None:
        if isinstance(schema, dict):
            found.update(schema.get("properties", {}))
            for part in schema.values():
                members(part)
        elif isinstance(schema, list):
            for part in schema:
                members(part)

    for operation in (operation for path in openapi["paths"].values() for operation in path.values()):
        found.update(parameter["name"] for parameter in operation.get("parameters", ()))
        members(operation.get("requestBody", {}))
    seen = [method.input_type for method in METHODS.values()]
    while seen:
        message = seen.pop()
        found.update(f.name for f in message.fields)
        seen += [f.message_type for f in message.fields if f.message_type is not None]
    return found


@pytest.mark.parametrize("case", [pytest.param(case, id=case.id) for case in CASES if case.absent])
def test_what_cannot_be_given_has_no_name(case, corpus_service):
    names = names_that_requests_have(corpus_service.http.get("/openapi.json").json())
    assert {"map_id", "T_odom_submap", "t_odom_sensor", "descriptor"} <= names
    assert not names & set(case.absent)


def test_the_suite_itself_notices_a_wrong_answer_and_something_stored():
    case = next(case for case in CASES if case.row == "G04")
    with pytest.raises(AssertionError):
        judge(case, case.http, Answer(202, "", {}))
    with pytest.raises(AssertionError):
        judge(case, case.http, Answer(422, "BAD_FIELD", {}))
    assert refused(case, "http") and refused(case, "grpc")
    assert filled({"a": ["{map}"]}, {"map": "maps/m"}) == {"a": ["maps/m"]}
    assert body_of("G01-empty.npy") == b""
