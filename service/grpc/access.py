"""Authorisation of RPCs by the list of calls; and of open streams, again and again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

from revisit.api.calls import CALLS, Call
from revisit.service.domain.callers import enter
from revisit.service.domain.errors import Unauthenticated
from revisit.service.edge import requests
from revisit.service.edge.requests import refusal
from revisit.service.features.keys.admission import STREAM_RECHECK_S, Credential
from revisit.service.grpc.open_connections import OpenConnections, endpoint_of
from revisit.service.use_cases import UseCases


class Gate:
    """Admits calls, and watches over those that last."""

    def __init__(
        self,
        use_cases: UseCases,
        open_connections: OpenConnections | None = None,
        *,
        recheck_s: float = STREAM_RECHECK_S,
    ) -> None:
        """Verifies the credential of an open stream again every `recheck_s` seconds; tells `open_connections`
        of admitted peers.
        """
        self._access = use_cases.access
        self._open_connections = open_connections or OpenConnections()
        self._recheck_s = recheck_s

    async def admit(self, method: str, context: Any) -> None:
        """Admit the caller of `/revisit.v1.Service/Method`.

        Raises Unauthenticated, PermissionDenied, TooManyFailures, RateLimited.
        """
        shown, peer = credential_of(context), str(context.peer())
        enter(await self._access.admit_call(shown, call_of(method).row.scopes, method))
        self._open_connections.admit(peer)

    async def verify(self, method: str, shown: Credential) -> None:
        """As `admit`, again, for the credential of an open stream."""
        enter(await self._access.admit(shown, call_of(method).row.scopes, method))

    async def admit_public(self, peer: str) -> None:
        """Return when a call that needs no credential may begin. Raises RateLimited."""
        await self._access.admit_public(endpoint_of(peer).address)

    async def delay_refusal(self, peer: str) -> None:
        """Wait before an unauthenticated call is refused, if those of its address are refused too often."""
        await self._access.delay_refusal(endpoint_of(peer).address)

    @asynccontextmanager
    async def watching(self, method: str, context: Any) -> AsyncIterator[None]:
        """Admit the caller of a stream; the block ends with Unauthenticated once the credential has lost its right.

        The block must be left in the task that entered it. Raises the errors of `admit`.
        """
        # Read now: the watch may outlive the call, and gRPC 1.85 crashes where an ended call is asked for its peer.
        shown = credential_of(context)
        await self.admit(method, context)
        try:
            async with asyncio.timeout(None) as stream:
                watch = asyncio.create_task(self._watch(method, shown, stream))
                try:
                    yield
                finally:
                    watch.cancel()
        except TimeoutError as error:
            if stream.expired():
                raise Unauthenticated("the credential has lost its right: the stream ends") from error
            raise

    async def _watch(self, method: str, shown: Credential, stream: asyncio.Timeout) -> None:
        await refusal(partial(self.verify, method, shown), self._recheck_s)
        stream.reschedule(asyncio.get_running_loop().time())


def credential_of(context: Any) -> Credential:
    """The credential of a call: metadata, verified client certificate, the peer's address. Raises Unauthenticated."""
    sent = [str(value) for name, value in context.invocation_metadata() or () if name == "authorization"]
    names = context.auth_context().get("x509_subject_alternative_name", ())
    decoded = [name.decode("utf-8", "replace") for name in names]
    return requests.credential_of(sent, endpoint_of(str(context.peer())).address, decoded)


def call_of(path: str) -> Call:
    """The call of `/revisit.v1.Service/Method`."""
    return CALLS[path.rpartition("/")[2]]
