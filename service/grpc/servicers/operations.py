"""OperationService."""

from __future__ import annotations

from typing import Any

from revisit.core.errors import BadField
from revisit.service.application import UseCases
from revisit.service.grpc import messages, names
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import operation_pb2 as pb
from revisit.v1 import operation_pb2_grpc

DEFAULT_WAIT_S = 30.0
MAX_WAIT_S = 60.0


class OperationServicer(operation_pb2_grpc.OperationServiceServicer):
    """Get, list, wait for and retry operations."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._operations = use_cases.operations
        self._dead_letters = use_cases.dead_letters

    async def GetOperation(self, request: pb.GetOperationRequest, context: Any) -> pb.GetOperationResponse:
        """Get an operation."""
        view = await self._operations.get(tenant_of(context), names.operation_id(request.name))
        return pb.GetOperationResponse(operation=messages.operation_message(view))

    async def ListOperations(self, request: pb.ListOperationsRequest, context: Any) -> pb.ListOperationsResponse:
        """List the operations."""
        paging, state = messages.page_request(request), messages.operation_state(request.state)
        page = await self._operations.list(tenant_of(context), paging, state)
        items = [messages.operation_message(view) for view in page.items]
        return pb.ListOperationsResponse(operations=items, next_page_token=page.next_token)

    async def WaitOperation(self, request: pb.WaitOperationRequest, context: Any) -> pb.WaitOperationResponse:
        """The operation once it has ended, or as it stands after the timeout."""
        timeout_s = request.timeout_s if request.HasField("timeout_s") else DEFAULT_WAIT_S
        if not 0.0 <= timeout_s <= MAX_WAIT_S:
            raise BadField(f"timeout_s must be in 0..{MAX_WAIT_S:g}", field="timeout_s")
        view = await self._operations.wait(tenant_of(context), names.operation_id(request.name), timeout_s)
        return pb.WaitOperationResponse(operation=messages.operation_message(view))

    async def RetryOperation(self, request: pb.RetryOperationRequest, context: Any) -> pb.RetryOperationResponse:
        """Queue a failed description again."""
        view = await self._dead_letters.retry(tenant_of(context), names.operation_id(request.name))
        return pb.RetryOperationResponse(operation=messages.operation_message(view))
