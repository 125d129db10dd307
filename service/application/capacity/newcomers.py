"""Newcomers: connections that have not shown yet who they are, bounded by the address that they come from."""

from __future__ import annotations

import ipaddress
import itertools
from collections.abc import Callable

ADDRESS_NEWCOMERS = 256
"""Of one address at the same time. Behind one address may be a fleet or a proxy, whose newcomers stay so for some
milliseconds; half of what the HTTP side lets in."""

NETWORK_BITS = 64
"""Of an IPv6 address: whoever has one has all that begin alike."""

Leave = Callable[[], None]
"""Ends a connection."""


class Newcomers:
    """One too many of an address takes the place of the one of that address that has been a newcomer the longest.

    All calls come from the event loop.
    """

    def __init__(self, most: int = ADDRESS_NEWCOMERS) -> None:
        """`most` of each address."""
        self._most = most
        self._numbers = itertools.count()
        self._by_holder: dict[str, dict[int, Leave]] = {}

    def arrive(self, address: str, leave: Leave) -> Callable[[], None]:
        """One more, which `leave` ends; returns what to call, once or more, when it is no newcomer any longer."""
        holder, number = holder_of(address), next(self._numbers)
        here = self._by_holder.setdefault(holder, {})
        here[number] = leave
        if len(here) > self._most:
            here.pop(next(iter(here)))()
        return lambda: self._settle(holder, number)

    def of(self, address: str) -> int:
        """How many newcomers this address has."""
        return len(self._by_holder.get(holder_of(address), ()))

    def _settle(self, holder: str, number: int) -> None:
        here = self._by_holder.get(holder, {})
        here.pop(number, None)
        if not here:
            self._by_holder.pop(holder, None)


def holder_of(address: str) -> str:
    """Whom an address stands for: itself, or the network that an IPv6 address is in."""
    try:
        known = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(known, ipaddress.IPv4Address):
        return address
    if known.ipv4_mapped is not None:
        return str(known.ipv4_mapped)
    return str(ipaddress.ip_network((known, NETWORK_BITS), strict=False))
