"""The jobs about a whole map that the service queues by itself: of each kind one that waits at most, so that no backlog
bounds them."""

from __future__ import annotations

from revisit.service.capacity.backlog import LAST, queued_job, same_job
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import LoopState, OperationKind
from revisit.service.ports.transactions import UnitOfWork


def post_map_job(
    uow: UnitOfWork,
    tenant: TenantId,
    map_id: str,
    kind: OperationKind,
    policy: Policy,
    now_ns: int,
    delay_ms: int = 0,
    priority: int = 1,
) -> JobRecord:
    """Queue a job about a map, not to be run before `delay_ms` have passed."""
    job = queued_job(tenant, kind, f"maps/{map_id}", {"map_id": map_id}, policy, now_ns, priority)
    return uow.queue.enqueue(job, delay_ms=delay_ms)


def waiting_map_job(uow: UnitOfWork, tenant: TenantId, map_id: str, kind: OperationKind) -> JobRecord | None:
    """The job of this kind about a map that no worker has taken yet."""
    return same_job(uow, tenant, kind, f"maps/{map_id}", {"map_id": map_id})


def recall_loops(uow: UnitOfWork, tenant: TenantId, map_id: str, policy: Policy, now_ns: int) -> None:
    """Let the rejected loops of a map that has a new version be tested again (docs/decisions/0090), and those that
    anchors chose be held against them (docs/decisions/0362).

    Where the service optimises maps by itself; where a person asks for each version, loops stay as they are. All other
    work of the tenant goes before it: a robot waits for a loop, and nobody for this.
    """
    if not policy.optimise_after_loops or waiting_map_job(uow, tenant, map_id, OperationKind.RECALL_LOOPS) is not None:
        return
    rejected = uow.loops.find(tenant, limit=1, map_id=map_id, state=LoopState.REJECTED.value, manual=False)
    if rejected or is_or_was_anchored(uow, tenant, map_id):
        post_map_job(uow, tenant, map_id, OperationKind.RECALL_LOOPS, policy, now_ns, priority=LAST)


def is_or_was_anchored(uow: UnitOfWork, tenant: TenantId, map_id: str) -> bool:
    """Whether a map has anchors, or had some: it has an origin still, or a version is kept that they took part in."""
    record = uow.maps.get(tenant, map_id)
    if record is None:
        return False
    if record.origin is not None or uow.anchors.find(tenant, limit=1, map_id=map_id):
        return True
    versions = uow.map_versions.count
    return versions(tenant, map_id=map_id, anchors=None) < versions(tenant, map_id=map_id)
