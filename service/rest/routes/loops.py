"""`/v1/maps/{map}/loopClosures`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from revisit.service.application.access.callers import Scope
from revisit.service.application.catalogue.loops import LoopState
from revisit.service.rest.access import allows
from revisit.service.rest.parameters import Cases, Fresh, Id, Paging, Tenant
from revisit.service.rest.schemas import LoopClosure, LoopClosurePage

router = APIRouter(prefix="/v1/maps/{map_id}/loopClosures", tags=["loop closures"])


@router.get("", dependencies=[allows(Scope.QUERY)])
async def list_loop_closures(
    map_id: Id,
    cases: Cases,
    tenant: Tenant,
    paging: Paging,
    fresh: Fresh,
    state: LoopState | None = None,
    session_id: Annotated[str | None, Query(max_length=64)] = None,
) -> LoopClosurePage:
    """List the loop closures of a map with their evidence, oldest first."""
    page = await cases.loops.list(tenant, map_id, paging, state, session_id, fresh)
    return LoopClosurePage(loop_closures=[LoopClosure.of(view) for view in page.items], next_page_token=page.next_token)


@router.get("/{loop_id}", dependencies=[allows(Scope.QUERY)])
async def get_loop_closure(map_id: Id, loop_id: Id, cases: Cases, tenant: Tenant) -> LoopClosure:
    """Get a loop closure with its evidence."""
    return LoopClosure.of(await cases.loops.get(tenant, map_id, loop_id))
