"""SessionService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import session_pb2 as pb
from revisit.v1 import session_pb2_grpc


class SessionServicer(session_pb2_grpc.SessionServiceServicer):
    """Create, get, list, finish and delete sessions."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._sessions = use_cases.sessions

    async def CreateSession(self, request: pb.CreateSessionRequest, context: Any) -> pb.CreateSessionResponse:
        """Create a session."""
        created = await self._sessions.create(tenant_of(context), requests.create_session(request))
        return pb.CreateSessionResponse(session=answers.of_session(created.session), replay=created.replay)

    async def GetSession(self, request: pb.GetSessionRequest, context: Any) -> pb.GetSessionResponse:
        """Get a session."""
        view = await self._sessions.get(tenant_of(context), names.session_key(request.name))
        return pb.GetSessionResponse(session=answers.of_session(view))

    async def ListSessions(self, request: pb.ListSessionsRequest, context: Any) -> pb.ListSessionsResponse:
        """List the sessions of a map."""
        map_id = names.map_id(request.parent, "parent")
        page = await self._sessions.list(tenant_of(context), map_id, requests.page(request))
        return await page_message(pb.ListSessionsResponse, "sessions", page, answers.of_session)

    async def FinishSession(self, request: pb.FinishSessionRequest, context: Any) -> pb.FinishSessionResponse:
        """Finish a session."""
        view = await self._sessions.finish(tenant_of(context), names.session_key(request.name))
        return pb.FinishSessionResponse(session=answers.of_session(view))

    async def DeleteSession(self, request: pb.DeleteSessionRequest, context: Any) -> pb.DeleteSessionResponse:
        """Delete a session."""
        await self._sessions.delete(tenant_of(context), names.session_key(request.name))
        return pb.DeleteSessionResponse()
