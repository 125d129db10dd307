"""What the HTTP side accepts at most; `revisit.formats.CloudLimits` bounds what a body decompresses to."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 2**20


@dataclass(frozen=True)
class HttpLimits:
    """Sizes in bytes, of a body as it is sent; times in seconds."""

    body_bytes: int = 32 * MIB
    json_depth: int = 16
    json_containers: int = 256
    """Arrays and objects in a body."""
    json_keys: int = 64
    """Of one object."""
    body_grace_s: float = 10.0
    """Time that any body may take."""
    body_bytes_per_s: int = 8 * 1024
    """The rate above which a body may take longer, on average since it began."""
    requests: int = 1024
    """Requests that are being answered at the same time; health is told beyond them."""
    watches: int = 128
    """Streams of events that are open at the same time."""
    tenant_watches: int = 64
    client_watches: int = 16
    """Of one API key; a page in a browser holds one."""
