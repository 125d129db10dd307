"""SystemService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers
from revisit.v1 import system_pb2 as pb
from revisit.v1 import system_pb2_grpc


class SystemServicer(system_pb2_grpc.SystemServiceServicer):
    """What the service is doing."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._system = use_cases.system

    async def GetStatus(self, _request: pb.GetStatusRequest, context: Any) -> pb.GetStatusResponse:
        """Queue depth, index size, workers and versions."""
        return pb.GetStatusResponse(**answers.of_status(await self._system.status(tenant_of(context))))
