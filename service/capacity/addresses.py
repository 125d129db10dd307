"""Whose an address is: bounds of callers without a credential count by its holder."""

from __future__ import annotations

import ipaddress
from functools import lru_cache

from revisit.service.capacity.budget import MOST_HOLDERS
from revisit.service.capacity.limits import NETWORK_BITS_IPV4, NETWORK_BITS_IPV6


@lru_cache(MOST_HOLDERS)
def holder_of(address: str) -> str:
    """The holder of an address: itself, or the network of an IPv6 address."""
    try:
        known = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(known, ipaddress.IPv4Address):
        return address
    if known.ipv4_mapped is not None:
        return str(known.ipv4_mapped)
    return str(ipaddress.ip_network((known, NETWORK_BITS_IPV6), strict=False))


@lru_cache(MOST_HOLDERS)
def network_of(address: str) -> str:
    """The network that an address is in: a /24, or the /64 of an IPv6 address."""
    holder = holder_of(address)
    try:
        return str(ipaddress.ip_network((ipaddress.IPv4Address(holder), NETWORK_BITS_IPV4), strict=False))
    except ValueError:
        return holder
