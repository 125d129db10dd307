"""Every bound of what the gateway does for its clients at a time, with unit and reason.

Settings change `client_points_per_s`, with it `tenant_points_per_s`, and `client_streams`, and state how many jobs
wait and how much a tenant stores; everything else is as it is here. Bounds of a single input are those of
`domain/limits.py`; times and sizes of connections belong to their transport.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields

MIB = 2**20
TENANT_SHARE = 0.75
"""The share of clouds and of bytes that one tenant may have in flight."""

# Cost of a request in points: the unit of rate limits, because the cost of most requests grows with their points. What
# holds the interpreter or the only writer costs five times its time, so that one key has a fifth of it
# (docs/decisions/0172).

POINTS_PER_S = 10_000_000
"""Points a second of a core: a point is a tenth of a microsecond."""

CALL_POINTS = 1_000
"""Of a request beside its points."""

CREATION_POINTS = 100_000
"""Of a new map, session, robot or webhook: five times the 2 ms of its commit."""

ANCHOR_POINTS = 15_000
"""Of a new anchor: five times the 0.3 ms of its row."""

STORED_ANCHOR_POINTS = 60
"""That the row of an anchor takes of the room of its tenant."""

READING_POINTS = 15_000
"""Of a new reading of radio, as of an anchor."""

STORED_READING_POINTS = 60
"""That the row of a reading takes of the room of its tenant."""

ROW_POINTS = 3_000
"""Of a row of a list: five times 60 us."""

COMPARISON_POINTS = 500_000
"""Of the keypoints of a loop: five times the 10 ms of their comparison."""

MESH_POINTS = 500_000
"""Of a mesh: the 50 to 70 ms of a worker that a cloud of so many points takes, and three commits."""

JSON_POINTS_A_BYTE = 0.65
"""Of a byte of JSON: five times the 13 ns of reading it."""

# Clouds in flight: received and not yet stored.

DECODERS = max(2, os.cpu_count() or 2)
"""Threads that decode clouds. More threads than cores would only slow the event loop down."""

SLOT_RETRY_S = 1.0
"""When to come back where all slots are taken."""

OVERLOAD_S = 10.0
"""For so long after a refusal, a tenant may have no more undecoded clouds than there are `DECODERS`: under lasting
overload a waiting line would only add to the latency of each request."""

BESIDE_OTHERS = 3
"""Clouds that a tenant has under way at a time where another has sent one within `OTHERS_S`. They take turns anyway at
the interpreter and the writer; more of them only make the others' wait longer."""

OTHERS_S = 5.0
CLOUD_POLL_S, CLOUD_POLLS = 0.005, 10
"""A further cloud of the tenant polls so often, and goes on in any case afterwards."""


@dataclass(frozen=True)
class CapacityLimits:
    """The limits of an installation. Rates are points a second, averaged over `burst_s`."""

    points_per_s: float = 40e6
    tenant_points_per_s: float = 20e6
    client_points_per_s: float = 10e6
    burst_s: float = 10.0
    clouds: int = 4 * DECODERS
    """Clouds in flight."""
    tenant_share: float = TENANT_SHARE
    streams: int = 256
    client_streams: int = 8


# Bytes in flight: bodies, messages and files that the gateway holds.

BYTES_IN_FLIGHT = 112 * MIB
"""With the process's own memory and the peak of decoding it stays below 768 MiB."""

BYTES_PATIENCE_S = 5.0
"""For so long a message or a file waits, unread and unmade, for others to be done."""

BYTES_RETRY_S = 2.0
"""When to come back where there is no room."""

# Calls that begin.

UNREAD_BYTES_A_CALL = 64 * 2**10
"""So many bytes of a body that was refused unread take about as long to throw away as a call takes to refuse."""

JSON_BYTES_A_CALL = 16 * 2**10
"""So many bytes of JSON take about as long to read as a call takes without them."""

MOST_CALLS_A_BODY = 20
"""A body counts as so many calls at most."""

REFUSED_FOR_S = 1.0
"""For so long after a client was refused for its rate, its calls come at the pace of `over_rate_calls_per_s`."""

CALL_POLL_S, CALL_POLLS = 0.004, 6
"""So often, and for so long, such a call polls whether clouds of other tenants are stored just now: they go first."""


@dataclass(frozen=True)
class PaceLimits:
    """Calls that begin, a second and in all. The first `burst` of calls that come together wait for nothing."""

    client_calls_per_s: float = 300.0
    """About a quarter of one core."""
    tenant_calls_per_s: float = 450.0
    over_rate_calls_per_s: float = 110.0
    """Of a client that sends more than its rate limit takes: ten times the large clouds that a service takes."""
    refusals_per_s: float = 100.0
    """Of one address, to callers that nobody knows."""
    public_calls_per_s: float = 100.0
    """Of one address, without a credential; health is told beyond them."""
    burst: int = 20
    """Together they hold up the event loop for about 20 ms; as many of one address are refused at once."""
    most_wait_s: float = 3.0
    waiting: int = 640
    """Calls of all callers that wait; each holds a request or a call, but no slot yet."""
    unauthenticated_waiting: int = 160
    """As `waiting`, of callers that nobody knows: they keep no one else from waiting."""


# Calls that are open.

ONE_KEPT_IN = 8
"""One slot in so many is kept for groups that hold none."""


@dataclass(frozen=True)
class Share:
    """The slots of one kind: `most` in all, `group` of them for one group that is alone, `holder` for one holder.

    A group is a tenant and its holders are clients; of calls without a credential, an address and its connections.
    """

    what: str
    most: int
    group: int
    holder: int
    names: tuple[str, str] = ("tenant", "client")

    def beside(self, others: int) -> int:
        """Slots that one group may hold beside `others` of other groups: its share of the rest.

        The last ones are kept for groups that hold none, one for each.
        """
        left = min(self.group * (self.most - others) // self.most, self.most - self.kept - others)
        return max(left, 1 if others < self.most else 0)

    @property
    def kept(self) -> int:
        """Slots that are kept for groups that hold none."""
        return self.most // ONE_KEPT_IN


@dataclass(frozen=True)
class CallLimits:
    """Calls of admitted callers that are open at the same time over one transport, by kind."""

    calls: Share = Share("calls", 320, 240, 160)
    waits: Share = Share("waits", 384, 256, 128)
    """Calls that wait for an operation, for submaps, for a tile, or for a worker's answer."""
    watches: Share = Share("watches", 128, 64, 32)
    streams: Share = Share("streams", 320, 256, 64)
    """Calls of any kind, also before their kind is known; `CapacityLimits` bounds each kind."""

    @property
    def total(self) -> int:
        """All together."""
        return sum(getattr(self, kind.name).most for kind in fields(self))


PUBLIC_WATCHES = Share("watches without a credential", 64, 48, 8, ("address", "connection"))
"""Over gRPC."""

PUBLIC_CALLS_WAITING = 64
"""Calls of one address over gRPC without a message yet: one more replaces the oldest. So health is never behind calls
that only begin."""

# Work that tenants take turns at.

LONG_BODIES_AT_A_TIME = 16
"""Long JSON bodies that are read at the same time, one of each tenant."""

LISTS_AT_A_TIME = 2
"""Lists that are read at the same time, one of each tenant."""

BATCHES_AT_A_TIME = 1
"""Batches of events that are read at the same time."""

COMPARISONS_AT_A_TIME = 1
"""Pairs of submaps whose keypoints are compared at the same time."""

# Callers without a credential.

UNAUTHENTICATED_PER_ADDRESS = 256
"""Connections of one address at the same time. Behind one address may be a fleet or a proxy, and its connections stay
unauthenticated for some milliseconds; half the bound of the HTTP side."""

NETWORK_BITS_IPV6 = 64
"""The holder of an IPv6 address has all addresses that begin alike."""

NETWORK_BITS_IPV4 = 24
"""Addresses that begin alike have a pace together, too."""

KNOWN_S = 600.0
"""For so long after a call a credential is known."""

FAILURES_PER_S, FAILURES_AT_ONCE = 1.0, 200.0
"""Failed authentications of all addresses."""

ADDRESS_FAILURES_PER_S, ADDRESS_FAILURES_AT_ONCE = 0.2, 20.0
"""Failed authentications of one address."""


@dataclass(frozen=True)
class ArrivalRates:
    """Connections that may begin a second, and `burst_s` times as many at once.

    Authenticated ones do not count: a fleet behind one address, with keys, never comes near.
    """

    anonymous_per_s: float = 30.0
    """Of one address, that show no credential."""
    unknown_per_s: float = 100.0
    """Of one address, that show a credential which is not known, or that are encrypted, so that nothing can be seen."""
    network_times: float = 1.5
    """So many times as many of a /24 or a /64."""
    all_times: float = 2.0
    client_per_s: float = 100.0
    """Of one credential, which do not count for its address."""
    burst_s: float = 2.0


# Jobs that wait, and clouds that are stored: counted in the store.

BACKLOG_RETRY_S = 5.0
"""When to come back where the backlog is full."""

BACKLOG_RECOUNT_S = 0.05
"""A backlog that seems full is counted again at most this often, so that refusing costs next to nothing."""

POINT_BYTES = 12
"""Stored bytes of a point: three numbers of 32 bits."""

QUOTA_RETRY_S = 60.0
"""When to come back where the quota is reached: somebody must delete something first."""

QUOTA_RECOUNT_S = 1.0
"""The stored bytes of a tenant at its quota are counted again at most this often."""
