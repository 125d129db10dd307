"""`/v1/operations`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from revisit.service.application.access.callers import Scope
from revisit.service.application.query.operations import OperationState
from revisit.service.rest.access import allows
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import Operation, OperationPage

router = APIRouter(prefix="/v1/operations", tags=["operations"])


@router.get("", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_operations(
    cases: Cases, tenant: Tenant, paging: Paging, state: OperationState | None = None
) -> OperationPage:
    """List the operations, oldest first."""
    page = await cases.operations.list(tenant, paging, state)
    return OperationPage(operations=[Operation.of(view) for view in page.items], next_page_token=page.next_token)


@router.get("/{operation_id}:wait", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def wait_operation(
    operation_id: Id,
    cases: Cases,
    tenant: Tenant,
    timeout_s: Annotated[float, Query(ge=0, le=60, allow_inf_nan=False)] = 30.0,
) -> Operation:
    """The operation once it has ended, or as it stands after the timeout."""
    return Operation.of(await cases.operations.wait(tenant, operation_id, timeout_s))


@router.post("/{operation_id}:retry", dependencies=[allows(Scope.ADMIN)])
async def retry_operation(operation_id: Id, cases: Cases, tenant: Tenant) -> Operation:
    """Queue a failed description again; an operation that has not failed is left as it is."""
    return Operation.of(await cases.dead_letters.retry(tenant, operation_id))


@router.get("/{operation_id}", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_operation(operation_id: Id, cases: Cases, tenant: Tenant) -> Operation:
    """Get an operation. That of a query by cloud is forgotten a day after its end, or when the settings say."""
    return Operation.of(await cases.operations.get(tenant, operation_id))
