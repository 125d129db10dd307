"""Conversations about where a robot is: one answer to each scan, as long as the stream is open."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from revisit.core.errors import ErrorCode, MalformedBody, RevisitError
from revisit.service.calls.relocalisation import conversation_to_start, view_fields
from revisit.service.domain.callers import current_tenant
from revisit.service.domain.errors import Draining
from revisit.service.features.relocalisation.calls import Conversation
from revisit.service.status import STATUS, retry_after_s
from revisit.service.use_cases import UseCases
from revisit.service.wire import requests
from revisit.v1 import loop_closure_pb2 as pb

DRAIN_POLL_S = 0.1

ENDING = (ErrorCode.NOT_FOUND, ErrorCode.DRAINING, ErrorCode.DESCRIPTOR_MODEL_MISMATCH)
"""Errors after which no scan of the conversation is answered any more."""


class ConversationStreams:
    """LoopClosureService.Relocalise."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._use_cases = use_cases

    async def stream(
        self, messages: AsyncIterator[pb.RelocaliseRequest], _context: Any
    ) -> AsyncIterator[pb.RelocaliseResponse]:
        """See the proto file for the rules."""
        following = aiter(messages)
        opening = await self._next(following)
        if opening is None or opening.WhichOneof("request") != "open":
            raise MalformedBody("the first message of a conversation must be open, and only the first")
        tenant, conversations = current_tenant(), self._use_cases.conversations
        with conversations.reserve_stream(tenant):
            conversation = await conversations.begin(tenant, conversation_to_start(opening.open))
            while (message := await self._next(following)) is not None:
                if message.WhichOneof("request") != "scan":
                    raise MalformedBody("after open, a conversation carries scans only")
                yield await _answer(conversation, message.scan)

    async def _next(self, messages: AsyncIterator[pb.RelocaliseRequest]) -> pb.RelocaliseRequest | None:
        """The next message, None behind the last. Raises Draining as soon as the service stops."""
        coming = asyncio.ensure_future(anext(messages, None))
        try:
            while not coming.done():
                if self._use_cases.system.draining:
                    raise Draining
                await asyncio.wait({coming}, timeout=DRAIN_POLL_S)
            return coming.result()
        finally:
            coming.cancel()


async def _answer(conversation: Conversation, scan: pb.RelocaliseScan) -> pb.RelocaliseResponse:
    """The answer to a scan, or its refusal. Raises an error of `ENDING`."""
    try:
        cloud, pose = requests.cloud(scan.cloud), requests.pose(scan, "t_odom_sensor")
        answer = view_fields(await conversation.see(cloud, pose))
    except RevisitError as error:
        if error.code in ENDING:
            raise
        return pb.RelocaliseResponse(refusal=_refusal(error))
    return pb.RelocaliseResponse(answer=pb.RelocaliseAnswer(**answer))


def _refusal(error: RevisitError) -> pb.RelocaliseRefusal:
    status = STATUS[error.code]
    return pb.RelocaliseRefusal(
        code=status.grpc,
        reason=error.code.value,
        retryable=status.retryable,
        message=error.message[:800],
        retry_delay_s=retry_after_s(error, status),
    )
