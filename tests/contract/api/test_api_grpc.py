"""gRPC as such: statuses with details, malformed messages, limits, health, reflection."""

from __future__ import annotations

import grpc
import pytest
from google.rpc import error_details_pb2, status_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from revisit.service.grpc.server import MAX_MESSAGE_BYTES
from revisit.v1 import map_pb2, map_pb2_grpc

CREATE_MAP = "/revisit.v1.MapService/CreateMap"


@pytest.fixture
def channel(service):
    with grpc.insecure_channel(service.grpc, options=[("grpc.max_send_message_length", -1)]) as open_channel:
        yield open_channel


def failure(call):
    with pytest.raises(grpc.RpcError) as failed:
        call()
    return failed.value


def details_of(error):
    packed = dict(error.trailing_metadata())["grpc-status-details-bin"]
    status = status_pb2.Status.FromString(packed)
    found = {}
    for detail in status.details:
        name = detail.type_url.rpartition(".")[2]
        found[name] = getattr(error_details_pb2, name)()
        detail.Unpack(found[name])
    return status, found


def test_an_error_names_reason_field_and_request(channel):
    stub = map_pb2_grpc.MapServiceStub(channel)
    metadata = [("x-request-id", "job-7")]
    error = failure(lambda: stub.CreateMap(map_pb2.CreateMapRequest(map_id="../x"), metadata=metadata))
    status, details = details_of(error)
    assert (error.code(), status.message) == (grpc.StatusCode.INVALID_ARGUMENT, error.details())
    assert details["ErrorInfo"].reason == "BAD_FIELD"
    assert details["BadRequest"].field_violations[0].field == "map_id"
    assert details["RequestInfo"].request_id == "job-7"
    assert "RetryInfo" not in details


def test_a_draining_service_is_not_healthy(channel, service):
    stopping = service.world.context.stopping
    stopping.set()
    try:
        health = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
    finally:
        stopping.clear()
    assert health.status == health_pb2.HealthCheckResponse.NOT_SERVING


@pytest.mark.parametrize(
    "body",
    [b"\xff\xff\xff", b"\x0a\xff", b"\x0a\x02\xc3\x28", b"\x0b" * 20_000],
    ids=["tag", "length", "utf8", "depth"],
)
def test_bytes_that_are_no_message_are_an_invalid_argument(body, channel, service):
    before = service.stored()
    error = failure(lambda: channel.unary_unary(CREATE_MAP)(body))
    assert error.code() is grpc.StatusCode.INVALID_ARGUMENT
    assert details_of(error)[1]["ErrorInfo"].reason == "MALFORMED_BODY"
    assert service.stored() == before


def test_a_message_over_16_mib_is_refused(channel):
    error = failure(lambda: channel.unary_unary(CREATE_MAP)(bytes(MAX_MESSAGE_BYTES + 1)))
    assert error.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def test_an_unknown_method_is_unimplemented(channel):
    error = failure(lambda: channel.unary_unary("/revisit.v1.MapService/Explode")(b""))
    assert error.code() is grpc.StatusCode.UNIMPLEMENTED


def test_health_is_told_for_the_server_and_for_each_service(channel):
    stub = health_pb2_grpc.HealthStub(channel)
    for service_name in ("", "revisit.v1.IngestService", "revisit.v1.SubmapService"):
        answer = stub.Check(health_pb2.HealthCheckRequest(service=service_name))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
    error = failure(lambda: stub.Check(health_pb2.HealthCheckRequest(service="revisit.v1.NoService")))
    assert error.code() is grpc.StatusCode.NOT_FOUND
    watch = stub.Watch(health_pb2.HealthCheckRequest())
    assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
    watch.cancel()


def test_reflection_lists_every_service(channel):
    request = reflection_pb2.ServerReflectionRequest(list_services="")
    stub = reflection_pb2_grpc.ServerReflectionStub(channel)
    (answer,) = stub.ServerReflectionInfo(iter([request]))
    names = {service.name for service in answer.list_services_response.service}
    nouns = ("Map", "Robot", "Session", "Submap", "Ingest", "LoopClosure", "Operation", "System")
    assert {f"revisit.v1.{noun}Service" for noun in nouns} <= names
    assert "grpc.health.v1.Health" in names
