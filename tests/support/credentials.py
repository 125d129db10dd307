"""Keys for tests."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

import grpc

from revisit.service.features.keys.calls import CreateKey, NewKey
from tests.support.patience import PATIENCE_S
from tests.support.service_world import World

ALL_SCOPES = ("ingest", "query", "admin")


def a_key(world: World, tenant: str = "acme", scopes=ALL_SCOPES, lifetime_s: float | None = None) -> NewKey:
    """A new key of `tenant`."""
    return asyncio.run(world.use_cases.keys.create(CreateKey(tenant, scopes, "a test", lifetime_s)))


def bearer(key: NewKey | str) -> dict[str, str]:
    """The header (or metadata) that shows a key."""
    return {"authorization": f"Bearer {key if isinstance(key, str) else key.text}"}


def ended(channel: grpc.Channel, method: Any, metadata: Iterable[tuple[str, str]] = (), request: bytes = b""):
    """Send one message to the RPC of a method descriptor; the code and the details that the call ends with."""
    kinds = {(False, False): "unary_unary", (False, True): "unary_stream", (True, True): "stream_stream"}
    kind = kinds[method.client_streaming, method.server_streaming]
    rpc = getattr(channel, kind)(f"/{method.containing_service.full_name}/{method.name}")
    try:
        answer = rpc(
            iter([request]) if method.client_streaming else request, metadata=tuple(metadata), timeout=PATIENCE_S
        )
        if method.server_streaming:
            list(answer)
    except grpc.RpcError as error:
        return error.code(), error.details()
    return grpc.StatusCode.OK, ""
