"""The gRPC server: the services of `revisit.v1`, health and reflection."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from revisit.service.application import UseCases
from revisit.service.application.capacity.call_slots import CallLimits, CallSlots
from revisit.service.application.contract.tracing import NoTracer, Tracer
from revisit.service.grpc.access import Gate, require_declared_scopes
from revisit.service.grpc.errors import LARGEST_MESSAGE_BYTES, ErrorInterceptor
from revisit.service.grpc.servicers.events import EventServicer
from revisit.service.grpc.servicers.health import HealthServicer
from revisit.service.grpc.servicers.ingest import IngestServicer
from revisit.service.grpc.servicers.loops import LoopClosureServicer
from revisit.service.grpc.servicers.map_files import MapFileServicer
from revisit.service.grpc.servicers.map_tiles import MapTileServicer
from revisit.service.grpc.servicers.mapping import MappingServicer
from revisit.service.grpc.servicers.maps import MapServicer
from revisit.service.grpc.servicers.operations import OperationServicer
from revisit.service.grpc.servicers.robots import RobotServicer
from revisit.service.grpc.servicers.sessions import SessionServicer
from revisit.service.grpc.servicers.submaps import SubmapServicer
from revisit.service.grpc.servicers.system import SystemServicer
from revisit.service.grpc.servicers.webhooks import WebhookServicer
from revisit.service.grpc.strangers import Strangers
from revisit.service.grpc.timing import CallTimer
from revisit.service.grpc.tracing import CallTracing
from revisit.service.metrics import RequestMetrics
from revisit.v1 import (
    event_pb2,
    event_pb2_grpc,
    ingest_pb2,
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

MAX_MESSAGE_BYTES = LARGEST_MESSAGE_BYTES
MAX_METADATA_BYTES = 16 * 2**10
MAX_CONCURRENT_CALLS = 256
"""Of one connection. `CallLimits` bounds what all together hold open."""

PUBLIC_CALLS = 128
"""What calls without a credential add to the bound of all calls: that is twice what may be open, for as many again may
be on their way in or out."""

CONNECTIONS = 4096
"""Open connections; each takes about 17 KiB while it is idle (VmRSS of a gateway with 3,000 of them)."""

OPTIONS = (
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_metadata_size", MAX_METADATA_BYTES),
    ("grpc.max_concurrent_streams", MAX_CONCURRENT_CALLS),
    ("grpc.server_handshake_timeout_ms", 10_000),  # by default 2 min, in which a silent socket holds its place
    ("grpc.max_connection_idle_ms", 300_000),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
    ("grpc.so_reuseport", 0),
    # Else a stream's window grows to megabytes, and so much of a message that nobody reads yet is held for each.
    ("grpc.http2.bdp_probe", 0),
)

_SERVICES: tuple[tuple[Any, Callable[[UseCases], object], Callable[..., None]], ...] = (
    (map_pb2, MapServicer, map_pb2_grpc.add_MapServiceServicer_to_server),
    (robot_pb2, RobotServicer, robot_pb2_grpc.add_RobotServiceServicer_to_server),
    (session_pb2, SessionServicer, session_pb2_grpc.add_SessionServiceServicer_to_server),
    (submap_pb2, SubmapServicer, submap_pb2_grpc.add_SubmapServiceServicer_to_server),
    (ingest_pb2, IngestServicer, ingest_pb2_grpc.add_IngestServiceServicer_to_server),
    (loop_closure_pb2, LoopClosureServicer, loop_closure_pb2_grpc.add_LoopClosureServiceServicer_to_server),
    (event_pb2, EventServicer, event_pb2_grpc.add_EventServiceServicer_to_server),
    (mapping_pb2, MappingServicer, mapping_pb2_grpc.add_MappingServiceServicer_to_server),
    (map_tile_pb2, MapTileServicer, map_tile_pb2_grpc.add_MapTileServiceServicer_to_server),
    (map_file_pb2, MapFileServicer, map_file_pb2_grpc.add_MapFileServiceServicer_to_server),
    (operation_pb2, OperationServicer, operation_pb2_grpc.add_OperationServiceServicer_to_server),
    (webhook_pb2, WebhookServicer, webhook_pb2_grpc.add_WebhookServiceServicer_to_server),
    (system_pb2, SystemServicer, system_pb2_grpc.add_SystemServiceServicer_to_server),
)


def create_server(
    use_cases: UseCases,
    *,
    requests: RequestMetrics | None = None,
    tracer: Tracer = NoTracer(),
    described: bool = True,
    call_limits: CallLimits = CallLimits(),
    strangers: Strangers | None = None,
    connections: int = CONNECTIONS,
) -> grpc.aio.Server:
    """A server over `use_cases` without a port: add one, start it on the running loop, stop it with a grace.

    `described`: it answers reflection. `strangers` is told who was admitted. One of more `connections` than these is
    closed at once. Raises RuntimeError where an RPC does not say who may call it.
    """
    services = [service for module, *_ in _SERVICES for service in module.DESCRIPTOR.services_by_name.values()]
    require_declared_scopes(services)
    timers = [] if requests is None else [CallTimer(requests)]
    guard = ErrorInterceptor(Gate(use_cases, strangers), CallSlots(call_limits), use_cases.budget)
    server = grpc.aio.server(
        interceptors=[CallTracing(tracer), *timers, guard],
        options=(*OPTIONS, ("grpc.max_allowed_incoming_connections", connections)),
        maximum_concurrent_rpcs=2 * (call_limits.total + PUBLIC_CALLS),
    )
    health = health_pb2.DESCRIPTOR.services_by_name["Health"].full_name
    names = [health, *(service.full_name for service in services)]
    for _, servicer, register in _SERVICES:
        register(servicer(use_cases), server)
    health_pb2_grpc.add_HealthServicer_to_server(HealthServicer(use_cases, frozenset(names)), server)
    if described:
        reflection.enable_server_reflection([*names, reflection.SERVICE_NAME], server)
    return server
