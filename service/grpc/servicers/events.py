"""EventService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.v1 import event_pb2 as pb
from revisit.v1 import event_pb2_grpc


class EventServicer(event_pb2_grpc.EventServiceServicer):
    """Watch what happens in a map."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._events = use_cases.events

    async def WatchEvents(self, request: pb.WatchEventsRequest, context: Any) -> AsyncIterator[pb.WatchEventsResponse]:
        """The events of a map, those to come too."""
        map_id, (after, kinds) = names.map_id(request.parent, "parent"), requests.watch(request)
        async for view in self._events.watch(tenant_of(context), map_id, after, kinds):
            yield pb.WatchEventsResponse(event=None if view is None else pb.Event(**answers.of_event(view)))
