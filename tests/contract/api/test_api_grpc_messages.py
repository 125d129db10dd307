"""Messages that no client of ours would write: generated ones, damaged ones, large ones, late ones; for every RPC."""

from __future__ import annotations

import os
import string

import grpc
import pytest
import structlog
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message_factory import GetMessageClass
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from revisit.core.errors import ErrorCode
from revisit.service.grpc.server import MAX_MESSAGE_BYTES
from revisit.service.status import STATUS
from tests.corpus.rows import UNROTATED, CloudToSend
from tests.corpus.sending import METHODS, cloud_message, grpc_reason, transform
from tests.support.cloud_files import records, valid_files
from tests.support.patience import PATIENCE_S

EXAMPLES = int(os.environ.get("REVISIT_GRPC_EXAMPLES", "6"))
LIMITS = settings(max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck))
# A watch ends only with its deadline.
DEADLINE_S = {"WatchLoopClosures": 0.1, "WatchCorrections": 0.1, "WatchEvents": 0.1, "WaitOperation": 0.3}
DOCUMENTED = {status.grpc for status in STATUS.values()} - {"INTERNAL"} | {"OK", "UNIMPLEMENTED", "DEADLINE_EXCEEDED"}

GOOD_CLOUDS = list(valid_files(records(120)).values())
NAMES = [
    "maps/town", "maps/town/sessions/monday", "maps/town/sessions/monday/submaps/a", "maps/town/loopClosures/l",
    "robots/rover", "operations/op-1", "maps/", "maps//sessions", "town", "monday", "",
]  # fmt: skip
LEADS_SOMEWHERE = {
    "parent": ["maps/town", "maps/town/sessions/monday"],
    "name": ["maps/town", "maps/town/sessions/monday", "maps/town/sessions/monday/submaps/a", "robots/rover"],
    "session": ["maps/town/sessions/monday"],
    "submap": ["maps/town/sessions/monday/submaps/a"],
}
TEXT = st.sampled_from(NAMES) | st.text(max_size=70) | st.text(string.printable, min_size=60, max_size=300)
NUMBERS = {
    FieldDescriptor.CPPTYPE_INT32: st.integers(-(2**31), 2**31 - 1) | st.integers(-2, 3),
    FieldDescriptor.CPPTYPE_INT64: st.integers(-(2**63), 2**63 - 1) | st.integers(-2, 3),
    FieldDescriptor.CPPTYPE_UINT32: st.integers(0, 2**32 - 1) | st.integers(0, 16),
    FieldDescriptor.CPPTYPE_UINT64: st.integers(0, 2**64 - 1) | st.integers(0, 16),
    FieldDescriptor.CPPTYPE_DOUBLE: st.floats() | st.sampled_from([0.0, 1.0, 1e308, 1e-320]),
    FieldDescriptor.CPPTYPE_FLOAT: st.floats(width=32) | st.sampled_from([0.0, 1.0]),
    FieldDescriptor.CPPTYPE_BOOL: st.booleans(),
    FieldDescriptor.CPPTYPE_ENUM: st.integers(-(2**31), 2**31 - 1) | st.integers(0, 8),
}


def values_of(field: FieldDescriptor) -> st.SearchStrategy:
    if field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE:
        return messages_of(field.message_type)
    if field.type == FieldDescriptor.TYPE_BYTES:
        return st.binary(max_size=200) | st.sampled_from([data for _, data in GOOD_CLOUDS])
    if field.name == "content_type":
        return st.sampled_from([media_type for media_type, _ in GOOD_CLOUDS]) | TEXT
    if field.type == FieldDescriptor.TYPE_STRING:
        return st.sampled_from(LEADS_SOMEWHERE[field.name]) | TEXT if field.name in LEADS_SOMEWHERE else TEXT
    return NUMBERS[field.cpp_type]


def messages_of(descriptor: Descriptor) -> st.SearchStrategy:
    """Messages of a type with any of their fields."""

    @st.composite
    def build(draw):
        if descriptor.name == "EncodedCloud" and draw(st.booleans()):
            media_type, data = draw(st.sampled_from(GOOD_CLOUDS))
            return GetMessageClass(descriptor)(content_type=media_type, data=data)
        if descriptor.name == "Quaternion" and draw(st.booleans()):
            return GetMessageClass(descriptor)(w=1.0)
        given_fields = {}
        for field in descriptor.fields:
            if draw(st.integers(0, 3)):
                strategy = values_of(field)
                given_fields[field.name] = draw(st.lists(strategy, max_size=3) if field.is_repeated else strategy)
        return GetMessageClass(descriptor)(**given_fields)

    return build()


@pytest.fixture(scope="module")
def service(sqlite_service):
    return sqlite_service


@pytest.fixture(scope="module")
def channel(service):
    with grpc.insecure_channel(service.grpc, options=[("grpc.max_send_message_length", -1)]) as open_channel:
        yield open_channel


@pytest.fixture
def town(channel):
    """What NAMES lead to, made anew for each test."""
    call(channel, "MapService/DeleteMap", bytes.fromhex("0a096d6170732f746f776e"))
    call(channel, "MapService/CreateMap", bytes.fromhex("0a04746f776e"))
    call(channel, "RobotService/CreateRobot", bytes.fromhex("0a05726f766572"))
    session = GetMessageClass(METHODS["SessionService/CreateSession"].input_type)(
        parent="maps/town", session_id="monday"
    )
    call(channel, "SessionService/CreateSession", session.SerializeToString())
    post = GetMessageClass(METHODS["SubmapService/PostSubmap"].input_type)(
        parent="maps/town/sessions/monday", submap_id="a", t_odom_submap=transform(UNROTATED),
        cloud=cloud_message(CloudToSend.read("good.rvq")),
    )  # fmt: skip
    assert call(channel, "SubmapService/PostSubmap", post.SerializeToString()) == ("OK", "")


def call(channel, name: str, *requests: bytes) -> tuple[str, str]:
    """Code and reason of a call with these messages as they are."""
    method = METHODS[name]
    path = f"/{method.containing_service.full_name}/{method.name}"
    timeout_s = DEADLINE_S.get(method.name, 40.0)
    try:
        if method.client_streaming:
            list(channel.stream_stream(path)(iter(requests), timeout=timeout_s))
        elif method.server_streaming:
            list(channel.unary_stream(path)(requests[0], timeout=timeout_s))
        else:
            channel.unary_unary(path)(requests[0], timeout=timeout_s)
    except grpc.RpcError as error:
        return error.code().name, grpc_reason(error)
    return "OK", ""


def assert_documented(answer: tuple[str, str]) -> None:
    code, reason = answer
    assert code in DOCUMENTED, answer
    if reason:
        assert STATUS[ErrorCode(reason)].grpc == code


@pytest.fixture
def no_defects():
    """A deadline can hide what went wrong in the service; its log cannot."""
    with structlog.testing.capture_logs() as logs:
        yield
    assert [entry for entry in logs if entry["log_level"] == "error"] == []


@pytest.mark.parametrize("name", METHODS)
def test_any_message_gets_a_documented_status(name, channel, town, no_defects):
    requests = st.lists(messages_of(METHODS[name].input_type), min_size=1, max_size=4 if "Stream" in name else 1)

    @LIMITS
    @given(requests)
    def check(sent):
        assert_documented(call(channel, name, *(request.SerializeToString() for request in sent)))

    check()


@pytest.mark.parametrize("name", METHODS)
def test_any_bytes_get_a_documented_status(name, channel, town, no_defects):
    @st.composite
    def damaged(draw):
        wire = bytearray(draw(messages_of(METHODS[name].input_type)).SerializeToString() or b"\x0a")
        for _ in range(draw(st.integers(1, 4))):
            wire[draw(st.integers(0, len(wire) - 1))] = draw(st.integers(0, 255))
        return bytes(wire[: draw(st.integers(0, len(wire)))])

    @LIMITS
    @given(damaged() | st.binary(max_size=60))
    def check(wire):
        assert_documented(call(channel, name, wire))

    check()


def test_a_number_beyond_what_a_database_compares_is_none_that_will_come(channel, town, no_defects):
    for after in (2**63, 2**64 - 1):
        request = GetMessageClass(METHODS["LoopClosureService/WatchLoopClosures"].input_type)(
            parent="maps/town", after=after
        )
        watched = call(channel, "LoopClosureService/WatchLoopClosures", request.SerializeToString())
        assert watched == ("DEADLINE_EXCEEDED", "")


def test_a_compressed_message_that_expands_past_the_limit_is_refused(channel):
    send = channel.unary_unary("/revisit.v1.MapService/CreateMap")
    with pytest.raises(grpc.RpcError) as refused:
        send(bytes(MAX_MESSAGE_BYTES + 1), compression=grpc.Compression.Gzip, timeout=PATIENCE_S)
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def test_metadata_over_the_limit_is_refused(channel):
    send = channel.unary_unary("/revisit.v1.MapService/ListMaps")
    send(b"", metadata=[("x-long", "a" * 8_000)], timeout=PATIENCE_S)
    with pytest.raises(grpc.RpcError) as refused:
        send(b"", metadata=[("x-long", "a" * 100_000)], timeout=PATIENCE_S)
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def code_of(send, request, timeout_s: float) -> str:
    try:
        send(request.SerializeToString(), timeout=timeout_s)
    except grpc.RpcError as error:
        return error.code().name
    return "OK"


def test_a_deadline_that_has_passed_leaves_nothing_behind(channel, town, service):
    send = channel.unary_unary("/revisit.v1.SubmapService/PostSubmap")
    request = GetMessageClass(METHODS["SubmapService/PostSubmap"].input_type)(
        parent="maps/town/sessions/monday", t_odom_submap=transform(UNROTATED),
        cloud=cloud_message(CloudToSend.read("good.rvq")),
    )  # fmt: skip
    before = service.stored()
    request.submap_id = "late"
    assert code_of(send, request, timeout_s=0.0) == "DEADLINE_EXCEEDED"
    assert service.stored() == before
    for number in range(20):
        request.submap_id = f"hasty-{number}"
        assert code_of(send, request, timeout_s=0.002) in ("OK", "DEADLINE_EXCEEDED")
        # Whether it was stored is settled by the same request again: there is one submap and one job, never half.
        send(request.SerializeToString(), timeout=PATIENCE_S)
    stored = [now - then for now, then in zip(service.stored(), before, strict=True)]
    assert stored == [0, 0, 0, 20, 20]
