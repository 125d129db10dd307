"""OperationService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import operation_pb2 as pb
from revisit.v1 import operation_pb2_grpc


class OperationServicer(operation_pb2_grpc.OperationServiceServicer):
    """Get, list, wait for, retry and cancel operations."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._operations = use_cases.operations
        self._dead_letters = use_cases.dead_letters

    async def GetOperation(self, request: pb.GetOperationRequest, context: Any) -> pb.GetOperationResponse:
        """Get an operation."""
        view = await self._operations.get(tenant_of(context), names.operation_id(request.name))
        return pb.GetOperationResponse(operation=answers.of_operation(view))

    async def ListOperations(self, request: pb.ListOperationsRequest, context: Any) -> pb.ListOperationsResponse:
        """List the operations."""
        paging, state = requests.page(request), requests.operation_state(request.state)
        page = await self._operations.list(tenant_of(context), paging, state)
        return await page_message(pb.ListOperationsResponse, "operations", page, answers.of_operation)

    async def WaitOperation(self, request: pb.WaitOperationRequest, context: Any) -> pb.WaitOperationResponse:
        """The operation once it has ended, or as it stands after the timeout."""
        operation_id, wait_s = names.operation_id(request.name), requests.wait_s(request)
        view = await self._operations.wait(tenant_of(context), operation_id, wait_s)
        return pb.WaitOperationResponse(operation=answers.of_operation(view))

    async def RetryOperation(self, request: pb.RetryOperationRequest, context: Any) -> pb.RetryOperationResponse:
        """Queue a failed description again."""
        view = await self._dead_letters.retry(tenant_of(context), names.operation_id(request.name))
        return pb.RetryOperationResponse(operation=answers.of_operation(view))

    async def CancelOperation(self, request: pb.CancelOperationRequest, context: Any) -> pb.CancelOperationResponse:
        """Cancel an operation that optimises or merges maps."""
        view = await self._operations.cancel(tenant_of(context), names.operation_id(request.name))
        return pb.CancelOperationResponse(operation=answers.of_operation(view))
