"""How many calls may be open at once: kinds of calls have places of their own, so that none takes another's.

Without this, whoever opens enough calls that last closes the port to everyone: to strangers `Health.Watch` is open.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass

from revisit.service.application.access.callers import current_actor, current_tenant
from revisit.service.application.capacity.places import Claim, Places

_LASTING = frozenset({"WatchLoopClosures", "WatchCorrections", "WatchEvents"})
_STREAMS = frozenset({"StreamScans"})


@dataclass(frozen=True)
class CallLimits:
    """Calls open at the same time. What is open to strangers has its own places, by connection and in all."""

    public_watches: int = 64
    connection_public_watches: int = 8
    public_calls: int = 64
    connection_public_calls: int = 16
    watches: int = 128
    tenant_watches: int = 64
    client_watches: int = 32
    connection_watches: int = 32
    calls: int = 320
    tenant_calls: int = 240
    client_calls: int = 160
    streams: int = 320
    """Those that have not said yet what they are for, too; `CapacityLimits` bounds those that have."""
    tenant_streams: int = 256
    client_streams: int = 64

    @property
    def total(self) -> int:
        """All together, and as many again that are being admitted or refused."""
        return 2 * (self.public_watches + self.public_calls + self.watches + self.calls + self.streams)


class CallPlaces:
    """Gives each call its place, or refuses it with RESOURCE_EXHAUSTED and a delay."""

    def __init__(self, limits: CallLimits = CallLimits()) -> None:
        """Places are those of one server."""
        self._limits = limits
        self._places = Places()

    def of_public(self, peer: str, *, lasting: bool) -> AbstractContextManager[None]:
        """The place of a call that needs no credential: health, reflection. Raises RateLimited."""
        limits = self._limits
        if lasting:
            return self._places.hold(
                Claim(("public watches", peer), limits.connection_public_watches, "watches of this connection"),
                Claim(("public watches",), limits.public_watches, "watches without a credential"),
            )
        return self._places.hold(
            Claim(("public calls", peer), limits.connection_public_calls, "calls of this connection"),
            Claim(("public calls",), limits.public_calls, "calls without a credential"),
        )

    def of_caller(self, method: str, peer: str) -> AbstractContextManager[None]:
        """The place of a call whose caller was admitted. Raises RateLimited."""
        name, tenant, client, limits = method.rpartition("/")[2], current_tenant(), current_actor(), self._limits
        if name in _STREAMS:
            return self._places.hold(
                Claim(("streams", tenant, client), limits.client_streams, "streams of this client"),
                Claim(("streams", tenant), limits.tenant_streams, "streams of this tenant"),
                Claim(("streams",), limits.streams, "streams"),
            )
        if name in _LASTING:
            return self._places.hold(
                Claim(("watches of connection", peer), limits.connection_watches, "watches here"),
                Claim(("watches", tenant, client), limits.client_watches, "watches of this client"),
                Claim(("watches", tenant), limits.tenant_watches, "watches of this tenant"),
                Claim(("watches",), limits.watches, "watches"),
            )
        return self._places.hold(
            Claim(("calls", tenant, client), limits.client_calls, "calls of this client"),
            Claim(("calls", tenant), limits.tenant_calls, "calls of this tenant"),
            Claim(("calls",), limits.calls, "calls"),
        )
