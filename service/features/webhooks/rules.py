"""Which addresses a client may have the service call: none in networks that only the service can reach."""

from __future__ import annotations

import ipaddress
from urllib.parse import SplitResult, urlsplit

from revisit.core.errors import BadField
from revisit.service.domain import limits

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

# The only part of IPv6 that is given out as addresses of the internet. Beyond it are forms that carry IPv4 addresses
# (::/96, ::ffff:0:0:0/96, 64:ff9b::/96), the site-local fec0::/10, and unassigned space: Python calls most of it
# global.
_GIVEN_OUT = ipaddress.IPv6Network("2000::/3")

# Within it, networks that carry IPv4 addresses (6to4, Teredo), and one for examples.
_NOT_PUBLIC = tuple(map(ipaddress.IPv6Network, ("2002::/16", "2001::/32", "3fff::/20")))


def is_public(address: str) -> bool:
    """Whether an IP address is one of the internet: not loopback, link-local, private, multicast or reserved."""
    try:
        parsed: Address = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    if isinstance(parsed, ipaddress.IPv6Address):
        if parsed.ipv4_mapped is not None:
            parsed = parsed.ipv4_mapped
        elif parsed not in _GIVEN_OUT or any(parsed in network for network in _NOT_PUBLIC):
            return False
    return parsed.is_global and not parsed.is_multicast


def validated_url(url: str, *, private: bool) -> str:
    """`url` if a webhook may have it: https with a host, nothing secret in it; with `private` also http.

    A name is resolved when something is sent: see `WebhookSender`. Raises BadField.
    """
    parts = _parts(url)
    if parts.scheme != "https" and not (private and parts.scheme == "http"):
        raise BadField("url must begin with https://", field="url")
    if not parts.hostname or parts.username is not None or parts.password is not None or parts.fragment:
        raise BadField("url must have a host, and neither a user nor a fragment", field="url")
    host = parts.hostname
    literal = ":" in host or host.rpartition(".")[2].isdigit() or host.lower().startswith("0x")
    if not private and ((literal and not is_public(host)) or host.rstrip(".").lower().endswith("localhost")):
        raise BadField("url leads to a private address; REVISIT_WEBHOOK_PRIVATE_NETWORKS allows those", field="url")
    return url


def _parts(url: str) -> SplitResult:
    if len(url) > limits.URL_CHARACTERS or not url.isascii() or not url.isprintable() or " " in url or "\\" in url:
        raise BadField(f"url must be at most {limits.URL_CHARACTERS} printable ASCII characters", field="url")
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError as error:
        raise BadField("url cannot be read", field="url") from error
    return parts
