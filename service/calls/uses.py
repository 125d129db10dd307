"""From a row of the list of calls to the function that answers it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import Any, cast

from revisit.api.calls import Call
from revisit.service.calls import (
    anchors,
    catalogue,
    ingest,
    loops,
    map_parts,
    mapping,
    operations,
    plain,
    plans,
    push,
    radio,
    retention,
    search,
)
from revisit.service.domain.identity import TenantId
from revisit.service.use_cases import UseCases
from revisit.service.wire.fields import Fields
from revisit.service.wire.rendering import Answer

ROOMS = (anchors, catalogue, ingest, search, loops, mapping, map_parts, operations, plans, push, radio, retention)


def answers(call: Call, cases: UseCases) -> Callable[[TenantId, Any], Awaitable[Answer]]:
    """Answers one request of a tenant."""
    return plain.answers(call, cases) if call.name in plain.USES else partial(_use(call), cases)


def streams(call: Call, cases: UseCases) -> Callable[[TenantId, Any], AsyncIterator[Fields]]:
    """Answers one request of a tenant with several messages."""
    return partial(_use(call), cases)


def _use(call: Call) -> Callable[..., Any]:
    """Raises RuntimeError for a call that nothing answers."""
    for room in ROOMS:
        if hasattr(room, call.use):
            return cast(Callable[..., Any], getattr(room, call.use))
    raise RuntimeError(f"no function {call.use} answers {call.path}")
