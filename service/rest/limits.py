"""Bounds of the HTTP side; `revisit.formats.CloudLimits` bounds a body's size after decompression."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.capacity.limits import CallLimits, Share

MIB = 2**20


@dataclass(frozen=True)
class HttpLimits:
    """Sizes in bytes, of a body as it is sent; times in seconds."""

    body_bytes: int = 32 * MIB
    json_depth: int = 16
    json_containers: int = 256
    """Arrays and objects in a short body; in proportion in those of calls that take longer ones."""
    json_keys: int = 64
    """Of one object."""
    body_grace_s: float = 10.0
    """Time that any body may take."""
    body_bytes_per_s: int = 8 * 1024
    """The rate above which a body may take longer, on average since it began."""
    requests: int = 1536
    """Requests that are being answered at the same time: those that hold a slot, those that wait for their turn, and
    those in admission. Health is answered beyond them.
    """
    calls: CallLimits = CallLimits(watches=Share("watches", 128, 64, 16))
    """Those of admitted callers; a page in a browser holds one watch."""
