"""Where a service under test sends its traces: a receiver of OTLP over gRPC that keeps what comes."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc
from opentelemetry.proto.collector.trace.v1 import trace_service_pb2, trace_service_pb2_grpc
from opentelemetry.proto.trace.v1.trace_pb2 import Span


class TraceReceiver(trace_service_pb2_grpc.TraceServiceServicer):
    """Everything it was sent, in its order."""

    def __init__(self) -> None:
        self.endpoint = ""
        self._received: list[trace_service_pb2.ExportTraceServiceRequest] = []

    def Export(self, request, context):
        """Take a batch of spans."""
        self._received.append(request)
        return trace_service_pb2.ExportTraceServiceResponse()

    def spans(self) -> list[Span]:
        """Every span."""
        resources = [resource for request in self._received for resource in request.resource_spans]
        return [span for resource in resources for scope in resource.scope_spans for span in scope.spans]

    def content(self) -> bytes:
        """All that was sent, as it was sent: names, attributes, states and the rest."""
        return b"".join(request.SerializeToString() for request in self._received)


@contextmanager
def trace_receiver() -> Iterator[TraceReceiver]:
    """A receiver that listens within the block."""
    receiver, server = TraceReceiver(), grpc.server(ThreadPoolExecutor(2))
    trace_service_pb2_grpc.add_TraceServiceServicer_to_server(receiver, server)
    receiver.endpoint = f"http://127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    yield receiver
    server.stop(None)
