"""Operations, and the state of the service."""

from __future__ import annotations

from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationState
from revisit.service.features.operations.progress import shown
from revisit.service.features.resources.views import PostedOperation
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, failure_fields, fields_of
from revisit.service.wire.rendering import Answer, Listed
from revisit.v1 import operation_pb2, system_pb2

DEFAULT_OPERATION_WAIT_S = 30.0


async def list_operations(cases: UseCases, tenant: TenantId, request: operation_pb2.ListOperationsRequest) -> Answer:
    """The operations."""
    state = requests.state_of(OperationState, operation_pb2.Operation.State, request.state)
    page = await cases.operations.list(tenant, requests.page(request), state)
    return Listed("operations", page, operation_fields)


async def wait_operation(cases: UseCases, tenant: TenantId, request: operation_pb2.WaitOperationRequest) -> Answer:
    """The operation once it has ended, or as it stands after the timeout."""
    given = requests.optional(request, "timeout_s")
    wait_s = DEFAULT_OPERATION_WAIT_S if given is None else limits.WAIT_S.validated(float(given), "timeout_s")
    view = await cases.operations.wait(tenant, names.operation_id(request.name), wait_s)
    return {"operation": operation_fields(view)}


async def get_status(cases: UseCases, tenant: TenantId, _request: system_pb2.GetStatusRequest) -> Answer:
    """Queue depth, index size, workers and versions."""
    status = await cases.system.status(tenant)
    workers = [{"worker_id": one.worker_id, "model_version": one.model_version} for one in status.workers]
    return fields_of(system_pb2.GetStatusResponse, status, workers=workers)


def operation_fields(job: JobRecord) -> Fields:
    """The fields of an Operation. Progress is that of a run: the last report of one that has ended is no news."""
    name, progress = f"operations/{job.operation_id}", shown(job) if job.state == OperationState.RUNNING else None
    return fields_of(operation_pb2.Operation, job, name=name, failure=failure_fields(job), progress=progress)


def asked_fields(posted: PostedOperation) -> Fields:
    """An operation that was asked for, as the two fields of its response."""
    return {"operation": operation_fields(posted.operation), "replay": posted.replay}
