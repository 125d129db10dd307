"""`/v1/operations`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.contract import limits
from revisit.service.application.contract.states import OperationState
from revisit.service.rest.access import allows
from revisit.service.rest.answers import Operation, OperationPage, answer, answers, page_answer
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import bounds
from revisit.service.wire.answers import of_operation
from revisit.service.wire.requests import DEFAULT_OPERATION_WAIT_S

router = APIRouter(prefix="/v1/operations", tags=["operations"])


@router.get("", **answers(OperationPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_operations(
    cases: Cases, tenant: Tenant, paging: Paging, state: OperationState | None = None
) -> Response:
    """List the operations, oldest first."""
    page = await cases.operations.list(tenant, paging, state)
    return await page_answer(OperationPage, "operations", page, of_operation)


@router.get("/{operation_id}:wait", **answers(Operation), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def wait_operation(
    operation_id: Id,
    cases: Cases,
    tenant: Tenant,
    timeout_s: Annotated[float, Query(**bounds(limits.WAIT_S))] = DEFAULT_OPERATION_WAIT_S,
) -> Response:
    """The operation once it has ended, or as it stands after the timeout."""
    return answer(Operation, of_operation(await cases.operations.wait(tenant, operation_id, timeout_s)))


@router.post("/{operation_id}:retry", **answers(Operation), dependencies=[allows(Scope.ADMIN)])
async def retry_operation(operation_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Queue a failed description again; an operation that has not failed is left as it is."""
    return answer(Operation, of_operation(await cases.dead_letters.retry(tenant, operation_id)))


@router.post("/{operation_id}:cancel", **answers(Operation), dependencies=[allows(Scope.INGEST, Scope.ADMIN)])
async def cancel_operation(operation_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """End an operation that optimises or merges maps: at once where it waits, else at its next step."""
    return answer(Operation, of_operation(await cases.operations.cancel(tenant, operation_id)))


@router.get("/{operation_id}", **answers(Operation), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_operation(operation_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get an operation. That of a query by cloud is forgotten a day after its end, or when the settings say."""
    return answer(Operation, of_operation(await cases.operations.get(tenant, operation_id)))
