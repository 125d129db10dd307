"""The gRPC server: the services of `revisit.v1`, health and reflection."""

from __future__ import annotations

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from revisit.api.calls import CALLS
from revisit.service.capacity.call_slots import CallSlots
from revisit.service.capacity.limits import CallLimits
from revisit.service.grpc.access import Gate
from revisit.service.grpc.errors import LARGEST_MESSAGE_BYTES, ErrorInterceptor
from revisit.service.grpc.handlers import handlers_of, services_of
from revisit.service.grpc.health import HealthServicer
from revisit.service.grpc.open_connections import OpenConnections
from revisit.service.grpc.timing import CallTimer
from revisit.service.grpc.tracing import CallTracing
from revisit.service.metrics import RequestMetrics
from revisit.service.ports.tracing import NoTracer, Tracer
from revisit.service.use_cases import UseCases

MAX_MESSAGE_BYTES = LARGEST_MESSAGE_BYTES
MAX_METADATA_BYTES = 16 * 2**10
MAX_CONCURRENT_CALLS = 256
"""Of one connection. `CallLimits` bounds the open calls of all together."""

PUBLIC_CALLS = 128
"""Calls without a credential in the bound of all calls: that is twice the open ones, for as many again may be on their
way in or out.
"""

CONNECTIONS = 4096
"""Open connections; each takes about 17 KiB while it is idle (VmRSS of a gateway with 3,000 of them)."""

OPTIONS = (
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_metadata_size", MAX_METADATA_BYTES),
    ("grpc.max_concurrent_streams", MAX_CONCURRENT_CALLS),
    ("grpc.server_handshake_timeout_ms", 10_000),  # by default 2 min, in which a silent socket holds its slot
    ("grpc.max_connection_idle_ms", 300_000),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
    ("grpc.so_reuseport", 0),
    # Else a stream's window grows to megabytes, and so much of a message that nobody reads yet is held for each.
    ("grpc.http2.bdp_probe", 0),
)


def create_server(
    use_cases: UseCases,
    *,
    requests: RequestMetrics | None = None,
    tracer: Tracer = NoTracer(),
    described: bool = True,
    call_limits: CallLimits = CallLimits(),
    open_connections: OpenConnections | None = None,
    connections: int = CONNECTIONS,
) -> grpc.aio.Server:
    """A server over `use_cases` without a port: add one, start it on the running loop, stop it with a grace.

    `described`: it answers reflection. `open_connections` is told of admitted peers. One of more `connections` than
    these is closed at once. Raises RuntimeError for an RPC without a declaration of its scopes.
    """
    services = services_of(CALLS)
    timers = [] if requests is None else [CallTimer(requests)]
    guard = ErrorInterceptor(Gate(use_cases, open_connections), CallSlots(call_limits), use_cases.budget)
    server = grpc.aio.server(
        interceptors=[CallTracing(tracer), *timers, guard],
        options=(*OPTIONS, ("grpc.max_allowed_incoming_connections", connections)),
        maximum_concurrent_rpcs=2 * (call_limits.total + PUBLIC_CALLS),
    )
    health = health_pb2.DESCRIPTOR.services_by_name["Health"].full_name
    names = [health, *(service.full_name for service in services)]
    server.add_generic_rpc_handlers(tuple(handlers_of(CALLS, use_cases)))
    health_pb2_grpc.add_HealthServicer_to_server(HealthServicer(use_cases, frozenset(names)), server)
    if described:
        reflection.enable_server_reflection([*names, reflection.SERVICE_NAME], server)
    return server
