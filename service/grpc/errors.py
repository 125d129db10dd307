"""Errors as google.rpc.Status, all from `service.status.STATUS`; one interceptor for every RPC.

The interceptor also parses: handlers receive the message's bytes from gRPC, so that a malformed message is
INVALID_ARGUMENT (gRPC itself would answer INTERNAL or UNKNOWN with the name of an exception class).
"""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing
from typing import Any, TypeVar, cast

import grpc
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message import DecodeError, Message
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.api.calls import Cost
from revisit.core.errors import MalformedBody, RevisitError, TooLarge
from revisit.service.capacity.byte_budget import ByteBudget, HeldBytes
from revisit.service.capacity.call_slots import CallSlots
from revisit.service.capacity.slots import Slots
from revisit.service.domain.callers import current_actor, current_tenant
from revisit.service.domain.errors import DeadlineExceeded
from revisit.service.edge.requests import REQUEST_ID, defect, request_id_of
from revisit.service.grpc.access import Gate, call_of
from revisit.service.grpc.public_calls import PublicCalls
from revisit.service.grpc.tracing import OWN_METHODS, STATUS_DETAILS, Wrapping
from revisit.service.ports.tracing import current_request
from revisit.service.status import ERROR_DOMAIN, STATUS, retry_after_s

MAX_MESSAGE_CHARACTERS = 800

MESSAGE_S = 120.0
"""Time for the message of a unary call of a caller that was admitted: a link of 1 Mbit/s brings 15 MB in it."""

PUBLIC_MESSAGE_S = 10.0
"""As `MESSAGE_S`, for a call that needs no credential."""

UNREAD_S = 60.0
"""A client that does not take a message of a stream for so long loses the stream."""

SMALL_MESSAGE_BYTES = 64 * 2**10
"""Of the message of a call that carries no cloud."""

LARGEST_MESSAGE_BYTES = 16 * 2**20

HELD_FORMS = 2
"""A message is held in so many forms until its call is answered: parsed, and as the bytes of its cloud."""


M = TypeVar("M")


class ErrorInterceptor(Wrapping):
    """Turns a handler's error into a status with details, for unary calls and streams.

    The caller is admitted, and given a slot, before the message is read: a unary call is served as a stream of one
    message, and its bytes wait with the client until then.
    """

    def __init__(self, gate: Gate, slots: CallSlots, budget: ByteBudget) -> None:
        """`gate` admits the callers; `slots` and `budget` bound their open calls and bytes."""
        self._gate = gate
        self._slots = slots
        self._public_calls = PublicCalls()
        self._budget = budget

    def wrapped(self, handler: Any, method: str) -> Any:
        """See `Wrapping`."""
        if not method.startswith(OWN_METHODS):
            return _public(handler, self._gate, self._public_calls)
        return _guarded(handler, method, self._gate, self._slots, self._budget)


def rpc_status(error: RevisitError, request_id: str) -> status_pb2.Status:
    """The google.rpc.Status of an error: ErrorInfo, RequestInfo and, where they apply, BadRequest and RetryInfo."""
    status = STATUS[error.code]
    metadata = {"retryable": str(status.retryable).lower()}
    expected = getattr(error, "expected", None)
    if isinstance(expected, int):
        metadata["expected_seq"] = str(expected)
    details: list[Message] = [
        error_details_pb2.ErrorInfo(reason=error.code.value, domain=ERROR_DOMAIN, metadata=metadata),
        error_details_pb2.RequestInfo(request_id=request_id),
    ]
    message = error.message[:MAX_MESSAGE_CHARACTERS]
    if error.field is not None:
        violation = error_details_pb2.BadRequest.FieldViolation(field=error.field[:100], description=message)
        details.append(error_details_pb2.BadRequest(field_violations=[violation]))
    delay_s = retry_after_s(error, status)
    if delay_s is not None:
        delay = Duration(seconds=int(delay_s), nanos=int(delay_s % 1 * 1e9))
        details.append(error_details_pb2.RetryInfo(retry_delay=delay))
    result = status_pb2.Status(code=code_of(error).value[0], message=message)
    for detail in details:
        result.details.add().Pack(detail)
    return result


def code_of(error: RevisitError) -> grpc.StatusCode:
    """The canonical code of an error."""
    return grpc.StatusCode[STATUS[error.code].grpc]


def _guarded(handler: Any, method: str, gate: Gate, slots: CallSlots, budget: ByteBudget) -> Any:
    parse, kind = handler.request_deserializer, _kind_of(method, slots)
    if handler.response_streaming:

        async def stream(requests: AsyncIterator[bytes], context: Any) -> AsyncIterator[Any]:
            try:
                async with gate.watching(method, context):
                    with slots.hold(kind, current_tenant(), current_actor()):
                        async with asyncio.timeout(None) as unread:
                            async for response in _streamed(handler, parse, requests, context):
                                unread.reschedule(asyncio.get_running_loop().time() + UNREAD_S)
                                yield response
                                unread.reschedule(None)
            except Exception as error:  # noqa: BLE001  # the last resort of every call
                _refuse(context, error)

        return grpc.stream_stream_rpc_method_handler(stream, None, handler.response_serializer)

    async def unary(requests: AsyncIterator[bytes], context: Any) -> Any:
        try:
            await gate.admit(method, context)
            tenant = current_tenant()
            with slots.hold(kind, tenant, current_actor()), budget.hold(tenant) as held:
                return await handler.unary_unary(await _message(method, parse, requests, held), context)
        except Exception as error:  # noqa: BLE001  # the last resort of every call
            _refuse(context, error)

    return grpc.stream_unary_rpc_method_handler(unary, None, handler.response_serializer)


def _kind_of(method: str, slots: CallSlots) -> Slots:
    """The slots that the calls of `/revisit.v1.Service/Method` hold."""
    held = {Cost.SCANS: slots.streams, Cost.WATCH: slots.watches}
    return held.get(call_of(method).row.cost, slots.calls)


async def _message(method: str, parse: Callable[[bytes], Any], requests: AsyncIterator[bytes], held: HeldBytes) -> Any:
    """The parsed message of a unary call, within the budget. Raises TooLarge, WorkersBusy and the errors of `_only`."""
    if call_of(method).row.cost is not Cost.CLOUD:
        message = await _only(requests, PUBLIC_MESSAGE_S)
        if len(message) > SMALL_MESSAGE_BYTES:
            raise TooLarge(f"a message of this call may have at most {SMALL_MESSAGE_BYTES} bytes")
    else:
        await held.wait_for(HELD_FORMS * LARGEST_MESSAGE_BYTES)
        message = await _only(requests)
        held.set(HELD_FORMS * len(message))
    return _parse(parse, message)


async def _streamed(
    handler: Any, parse: Callable[[bytes], Any], requests: AsyncIterator[bytes], context: Any
) -> AsyncIterator[Any]:
    if handler.request_streaming:
        answers = handler.stream_stream(_parsed(parse, requests), context)
    else:
        answers = handler.unary_stream(_parse(parse, await _only(requests)), context)
    async for response in answers:
        yield response


def _public(handler: Any, gate: Gate, calls: PublicCalls) -> Any:
    """A call without a credential (health, reflection): its handler parses its own messages."""
    parts = (handler.request_deserializer, handler.response_serializer)
    if handler.response_streaming:

        async def stream(requests: AsyncIterator[Any], context: Any) -> AsyncIterator[Any]:
            peer = str(context.peer())
            try:
                await gate.admit_public(peer)
                with calls.watch(peer):
                    given = requests if handler.request_streaming else await _only(requests, PUBLIC_MESSAGE_S)
                    answer = handler.stream_stream if handler.request_streaming else handler.unary_stream
                    async for response in answer(given, context):
                        yield response
            except RevisitError as error:
                _refuse(context, error)

        return grpc.stream_stream_rpc_method_handler(stream, *parts)

    async def unary(requests: AsyncIterator[Any], context: Any) -> Any:
        peer = str(context.peer())
        try:
            async with calls.message(peer):
                message = await _only(requests, PUBLIC_MESSAGE_S)
            return await handler.unary_unary(message, context)
        except RevisitError as error:
            await gate.delay_refusal(peer)
            _refuse(context, error)

    return grpc.stream_unary_rpc_method_handler(unary, *parts)


async def _only(requests: AsyncIterator[M], patience_s: float = MESSAGE_S) -> M:
    """The message of a unary call. Raises DeadlineExceeded, and MalformedBody where there is none."""
    try:
        async with asyncio.timeout(patience_s), _closed_after(requests) as messages:
            async for message in messages:
                return message
    except TimeoutError as error:
        raise DeadlineExceeded("the message came too slowly: repeat the call with the same id") from error
    raise MalformedBody("the call carries no message")


async def _parsed(parse: Callable[[bytes], Any], requests: AsyncIterator[bytes]) -> AsyncIterator[Any]:
    async with _closed_after(requests) as messages:
        async for message in messages:
            yield _parse(parse, message)


def _closed_after(requests: AsyncIterator[M]) -> aclosing[AsyncGenerator[M, None]]:
    """The messages of a call. gRPC's generator of them holds the last one, and itself, until it is closed."""
    return aclosing(cast("AsyncGenerator[M, None]", aiter(requests)))


def _parse(parse: Callable[[bytes], Any], request: bytes) -> Any:
    try:
        return parse(request)
    except DecodeError as error:
        raise MalformedBody("the message is not valid protobuf of its type") from error


def _refuse(context: Any, error: Exception) -> None:
    """End the call with the status of `error`: the handler's answer is not sent then.

    Not by `context.abort`: the call keeps its exception with all frames until the garbage collector comes round.
    Under a flood of refusals that took 48 ms every 11 s, and everybody waited (docs/decisions/0033).
    """
    request_id = request_id_of(current_request().request_id)
    if not isinstance(error, RevisitError):
        error = defect(error, request_id)
    status = rpc_status(error, request_id)
    # The frames of a refused call hold its message, and would until the garbage collector comes round.
    traceback.clear_frames(error.__traceback__)
    context.set_code(code_of(error))
    context.set_details(status.message)
    context.set_trailing_metadata(((STATUS_DETAILS, status.SerializeToString()), (REQUEST_ID, request_id)))
