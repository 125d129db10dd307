"""SystemService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc import messages
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import system_pb2, system_pb2_grpc


class SystemServicer(system_pb2_grpc.SystemServiceServicer):
    """What the service is doing."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._system = use_cases.system

    async def GetStatus(self, _request: system_pb2.GetStatusRequest, context: Any) -> system_pb2.GetStatusResponse:
        """Queue depth, index size, workers and versions."""
        return messages.status_message(await self._system.status(tenant_of(context)))
