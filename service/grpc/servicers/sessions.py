"""SessionService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.application.catalogue.sessions import CreateSession
from revisit.service.grpc import messages, names
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import session_pb2, session_pb2_grpc


class SessionServicer(session_pb2_grpc.SessionServiceServicer):
    """Create, get, list, finish and delete sessions."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._sessions = use_cases.sessions

    async def CreateSession(
        self, request: session_pb2.CreateSessionRequest, context: Any
    ) -> session_pb2.CreateSessionResponse:
        """Create a session."""
        robot_id = names.robot_id(request.robot, "robot") if request.robot else None
        command = CreateSession(names.map_id(request.parent, "parent"), request.session_id, robot_id)
        created = await self._sessions.create(tenant_of(context), command)
        return session_pb2.CreateSessionResponse(
            session=messages.session_message(created.session), replay=created.replay
        )

    async def GetSession(self, request: session_pb2.GetSessionRequest, context: Any) -> session_pb2.GetSessionResponse:
        """Get a session."""
        view = await self._sessions.get(tenant_of(context), names.session_key(request.name))
        return session_pb2.GetSessionResponse(session=messages.session_message(view))

    async def ListSessions(
        self, request: session_pb2.ListSessionsRequest, context: Any
    ) -> session_pb2.ListSessionsResponse:
        """List the sessions of a map."""
        map_id = names.map_id(request.parent, "parent")
        page = await self._sessions.list(tenant_of(context), map_id, messages.page_request(request))
        items = [messages.session_message(view) for view in page.items]
        return session_pb2.ListSessionsResponse(sessions=items, next_page_token=page.next_token)

    async def FinishSession(
        self, request: session_pb2.FinishSessionRequest, context: Any
    ) -> session_pb2.FinishSessionResponse:
        """Finish a session."""
        view = await self._sessions.finish(tenant_of(context), names.session_key(request.name))
        return session_pb2.FinishSessionResponse(session=messages.session_message(view))

    async def DeleteSession(
        self, request: session_pb2.DeleteSessionRequest, context: Any
    ) -> session_pb2.DeleteSessionResponse:
        """Delete a session."""
        await self._sessions.delete(tenant_of(context), names.session_key(request.name))
        return session_pb2.DeleteSessionResponse()
