"""grpc.health.v1.Health, answered from the service's own readiness."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
from grpc_health.v1 import health_pb2 as pb
from grpc_health.v1 import health_pb2_grpc

from revisit.service.use_cases import UseCases

WATCH_POLL_S = 0.5


class HealthServicer(health_pb2_grpc.HealthServicer):  # type: ignore[misc]  # its package ships no types
    """SERVING while ready, NOT_SERVING otherwise, for the server ("") and for each of its services."""

    def __init__(self, use_cases: UseCases, services: frozenset[str]) -> None:
        """`services` are the full names of the services that exist."""
        self._system = use_cases.system
        self._services = services | {""}

    async def Check(self, request: pb.HealthCheckRequest, context: Any) -> pb.HealthCheckResponse:
        """The state now; NOT_FOUND for an unknown service."""
        if request.service not in self._services:
            # Set, not raised, as in `grpc.errors`: the message is not sent then.
            context.set_code(grpc.StatusCode.NOT_FOUND)
            context.set_details("unknown service")
            return pb.HealthCheckResponse()
        return pb.HealthCheckResponse(status=await self._state(request.service))

    async def Watch(self, request: pb.HealthCheckRequest, _context: Any) -> AsyncIterator[pb.HealthCheckResponse]:
        """The state now and whenever it changes, until the service drains."""
        last: int | None = None
        while not self._system.draining:
            state = await self._state(request.service)
            if state != last:
                yield pb.HealthCheckResponse(status=state)
            last = state
            await asyncio.sleep(WATCH_POLL_S)
        yield pb.HealthCheckResponse(status=pb.HealthCheckResponse.NOT_SERVING)

    async def _state(self, service: str) -> Any:
        if service not in self._services:
            return pb.HealthCheckResponse.SERVICE_UNKNOWN
        ready = (await self._system.readiness()).ready
        return pb.HealthCheckResponse.SERVING if ready else pb.HealthCheckResponse.NOT_SERVING
