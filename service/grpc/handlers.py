"""The handlers of the RPCs, made from the list of calls: a message to the function that answers, its fields to one."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from itertools import groupby
from typing import Any

import grpc
from google.protobuf.descriptor import ServiceDescriptor

from revisit.api.calls import Call, Cost
from revisit.service.calls import uses
from revisit.service.domain.callers import current_tenant
from revisit.service.grpc.conversations import ConversationStreams
from revisit.service.grpc.scan_streams import ScanStreams
from revisit.service.use_cases import UseCases
from revisit.service.wire.rendering import rendered


def services_of(calls: Mapping[str, Call]) -> list[ServiceDescriptor]:
    """The services of the calls. Raises RuntimeError for an RPC without a row."""
    services = list(dict.fromkeys(call.method.containing_service for call in calls.values()))
    for service in services:
        for method in service.methods:
            if method.name not in calls or not calls[method.name].row.scopes:
                raise RuntimeError(f"{service.full_name}/{method.name} does not declare who may call it")
    return services


def handlers_of(calls: Mapping[str, Call], cases: UseCases) -> list[Any]:
    """The handlers, one a service. Raises RuntimeError for a call that nothing answers."""
    by_service = groupby(calls.values(), lambda call: str(call.method.containing_service.full_name))
    return [
        grpc.method_handlers_generic_handler(service, {call.name: _handler(call, cases) for call in of_service})
        for service, of_service in by_service
    ]


def _handler(call: Call, cases: UseCases) -> Any:
    parts = (call.request.FromString, call.response.SerializeToString)
    if call.row.cost is Cost.SCANS:
        return grpc.stream_stream_rpc_method_handler(_BOTH_WAYS[call.name](cases).stream, *parts)
    if call.method.server_streaming:
        return grpc.unary_stream_rpc_method_handler(_stream(call, cases), *parts)
    return grpc.unary_unary_rpc_method_handler(_unary(call, cases), *parts)


_BOTH_WAYS: Mapping[str, Any] = {"StreamScans": ScanStreams, "Relocalise": ConversationStreams}
"""What answers the streams in both directions."""


def _unary(call: Call, cases: UseCases) -> Any:
    answer, response = uses.answers(call, cases), call.response

    async def unary(request: Any, _context: Any) -> Any:
        return await rendered(await answer(current_tenant(), request), lambda fields: response(**fields))

    return unary


def _stream(call: Call, cases: UseCases) -> Any:
    answers, response = uses.streams(call, cases), call.response

    async def stream(request: Any, _context: Any) -> AsyncIterator[Any]:
        async for fields in answers(current_tenant(), request):
            yield response(**fields)

    return stream
