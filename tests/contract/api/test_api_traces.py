"""A request, its job and the worker that runs it are one trace, and share one id in the log; on both transports."""

from __future__ import annotations

import re
import threading
from contextlib import asynccontextmanager

import grpc
import httpx
import pytest
import structlog
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from revisit.formats import KITTI, encode_kitti
from revisit.service.adapters.opentelemetry_tracer import OpenTelemetryTracer
from revisit.service.grpc.server import create_server
from revisit.service.ports.tracing import NoTracer, validated_traceparent
from revisit.service.rest.app import create_app
from revisit.service.worker.heartbeat import WorkerIdentity
from revisit.service.worker.loop import Worker, WorkerLimits
from revisit.v1 import cloud_pb2, geometry_pb2, submap_pb2, submap_pb2_grpc
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED
from tests.support.patience import PATIENCE_S
from tests.support.service_world import TENANT, cloud_points, memory_world, open_session

TRACE = "4bf92f3577b34da6a3ce929d0e0e4736"
CLIENT = f"00-{TRACE}-00f067aa0ba902b7-01"
PARENT = "maps/town/sessions/monday"


class Traced:
    """A world with its spans, which posts a submap over either transport."""

    def __init__(self, tracer):
        self.world = memory_world()
        self.tracer = tracer

    async def post(self, transport, points=300, **headers):
        body = encode_kitti(cloud_points(1, points))
        if transport == "rest":
            return await self._over_rest(body, headers)
        return await self._over_grpc(body, headers)

    async def _over_rest(self, body, headers):
        app = httpx.ASGITransport(create_app(self.world.use_cases, tracer=self.tracer))
        query = {"submap_id": "a", "stamp_ns": 1, "T_odom_submap": "0,0,0,0,0,0,1"}
        async with httpx.AsyncClient(transport=app, base_url="http://localhost") as client:
            answer = await client.post(
                f"/v1/{PARENT}/submaps", params=query, content=body, headers={"Content-Type": KITTI, **headers}
            )
        assert answer.status_code == 202
        return answer.headers["x-request-id"]

    async def _over_grpc(self, body, headers):
        server = create_server(self.world.use_cases, tracer=self.tracer)
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        rotation = geometry_pb2.Quaternion(w=1.0)
        request = submap_pb2.PostSubmapRequest(
            parent=PARENT,
            submap_id="a",
            stamp_ns=1,
            t_odom_submap=geometry_pb2.Transform(translation=geometry_pb2.Vector3(), rotation=rotation),
            cloud=cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=KITTI, data=body)),
        )
        async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
            stub = submap_pb2_grpc.SubmapServiceStub(channel)
            call = stub.PostSubmap(request, metadata=tuple(headers.items()))
            await call
            trailing = dict(await call.trailing_metadata())
        await server.stop(None)
        return trailing["x-request-id"]

    def job(self):
        (job,) = self.world.context.transactions.read(lambda uow: uow.jobs.find(TENANT)).result()
        return job

    def work(self):
        identity = WorkerIdentity("w1", "fake-1", None)
        limits = WorkerLimits(jobs=1, recycled_at_bytes=2**40, job_timeout_s=60)
        worker = Worker(self.world.context, self.world.worker(), identity, threading.Event(), limits, self.tracer)
        thread = threading.Thread(target=worker.run)
        thread.start()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


@asynccontextmanager
async def traced(tracer):
    made = Traced(tracer)
    await open_session(made.world)
    yield made
    made.world.context.transactions.close()


@pytest.fixture
def spans():
    return InMemorySpanExporter()


@pytest.fixture
async def recorded(spans):
    async with traced(OpenTelemetryTracer(SimpleSpanProcessor(spans), "test")) as made:
        yield made


@pytest.mark.parametrize("transport", ["rest", "grpc"])
async def test_request_job_and_worker_are_one_trace_below_the_clients_span(recorded, spans, transport):
    await recorded.post(transport, traceparent=CLIENT)
    recorded.work()
    request, job = spans.get_finished_spans()
    assert [f"{span.context.trace_id:032x}" for span in (request, job)] == [TRACE, TRACE]
    assert f"{request.parent.span_id:016x}" == "00f067aa0ba902b7"
    assert job.parent.span_id == request.context.span_id
    assert recorded.job().traceparent == f"00-{TRACE}-{request.context.span_id:016x}-01"
    names = {
        "rest": "POST /v1/maps/{map_id}/sessions/{session_id}/submaps",
        "grpc": "/revisit.v1.SubmapService/PostSubmap",
    }
    assert (request.name, job.name) == (names[transport], "DESCRIBE_SUBMAP")
    assert request.kind.name == "SERVER" and job.kind.name == "CONSUMER"
    assert (job.attributes["revisit.operation"], job.attributes["revisit.attempt"]) == (recorded.job().operation_id, 1)


async def test_without_a_client_that_traces_the_request_begins_the_trace(recorded, spans):
    await recorded.post("rest", traceparent="00-not-a-trace-01")
    recorded.work()
    request, job = spans.get_finished_spans()
    assert request.parent is None
    assert job.context.trace_id == request.context.trace_id != int(TRACE, 16)


async def test_a_job_that_fails_is_a_failed_span(recorded, spans):
    await recorded.post("rest", points=CANNOT_BE_DESCRIBED)
    recorded.work()
    job = spans.get_finished_spans()[-1]
    assert job.status.status_code.name == "ERROR"
    assert job.status.description.startswith("UNUSABLE_CLOUD: ")


@pytest.mark.parametrize("transport", ["rest", "grpc"])
async def test_a_request_id_goes_from_the_client_to_the_log_of_the_worker_and_back(transport):
    async with traced(NoTracer()) as made:
        # The test's own list: the service's loggers are made once and keep their output.
        with structlog.testing.capture_logs(processors=[structlog.contextvars.merge_contextvars]) as lines:
            assert await made.post(transport, **{"x-request-id": "robot-7.42"}) == "robot-7.42"
            assert made.job().request_id == "robot-7.42"
            made.work()
    seen = {line["event"]: line.get("request_id") for line in lines}
    assert seen["request"] == seen["job_ended"] == "robot-7.42"


@pytest.mark.parametrize("transport", ["rest", "grpc"])
async def test_the_log_says_whose_request_it_was(transport):
    async with traced(NoTracer()) as made:
        with structlog.testing.capture_logs(processors=[structlog.contextvars.merge_contextvars]) as lines:
            await made.post(transport)
    (request,) = (line for line in lines if line["event"] == "request")
    assert (request["tenant"], request["caller"]) == (TENANT, "anyone")


@pytest.mark.parametrize("transport", ["rest", "grpc"])
async def test_a_request_id_that_could_forge_a_log_line_is_replaced(transport):
    async with traced(NoTracer()) as made:
        given = await made.post(transport, **{"x-request-id": "a b;c"})
    assert re.fullmatch("[0-9a-f]{32}", given)


async def test_where_tracing_is_off_a_clients_trace_still_reaches_the_job():
    async with traced(NoTracer()) as made:
        await made.post("rest", traceparent=CLIENT)
        assert made.job().traceparent == CLIENT


@pytest.mark.parametrize(
    "text",
    [
        None, "", "00", f"01-{TRACE}-00f067aa0ba902b7-01", f"00-{'0' * 32}-00f067aa0ba902b7-01",
        f"00-{TRACE}-{'0' * 16}-01", CLIENT.upper(), f"{CLIENT}\n", f"{CLIENT}-more", "x" * 100_000,
    ],
)  # fmt: skip
def test_what_is_no_trace_context_is_left_out(text):
    assert validated_traceparent(text) is None
