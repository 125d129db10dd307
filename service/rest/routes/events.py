"""`/v1/maps/{map}/events`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response

from revisit.api.calls import CALLS
from revisit.service.domain import limits
from revisit.service.domain.states import EventKind
from revisit.service.rest.access import served, until_refused
from revisit.service.rest.answers import event_answers
from revisit.service.rest.event_stream import EventStream
from revisit.service.rest.parameters import Cases, Id, Tenant
from revisit.service.rest.schemas import IN_DIGITS, bounds

router = APIRouter()

AFTER_HELP = "Events with a number above this, 0 for all that are kept; without it, what happens from now on."
LAST_HELP = "The id of the last event that was seen; goes before `after`. Browsers send it when they connect again."


@router.api_route(**served(CALLS["WatchEvents"]), **event_answers())
async def watch_events(
    map_id: Id,
    request: Request,
    cases: Cases,
    tenant: Tenant,
    after: Annotated[int | None, Query(**bounds(limits.EVENT_NUMBER), description=AFTER_HELP), IN_DIGITS] = None,
    last_event_id: Annotated[
        int | None, Header(**bounds(limits.EVENT_NUMBER), description=LAST_HELP), IN_DIGITS
    ] = None,
    kinds: Annotated[list[EventKind] | None, Query(max_length=len(EventKind))] = None,
) -> Response:
    """The events of a map as server-sent events, those to come too: loop closures and operations."""
    begin = after if last_event_id is None else last_event_id
    events = cases.events.watch(tenant, map_id, begin, frozenset(kinds or ()))
    return EventStream(events, lambda: until_refused(request, CALLS["WatchEvents"].row.scopes))
