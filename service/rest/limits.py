"""What the HTTP side accepts at most; `core.formats.CloudLimits` bounds what a body decompresses to."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 2**20


@dataclass(frozen=True)
class HttpLimits:
    """Sizes in bytes, of a body as it is sent."""

    body_bytes: int = 32 * MIB
    json_bytes: int = 1 * MIB
    json_depth: int = 16
