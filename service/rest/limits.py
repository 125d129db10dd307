"""What the HTTP side accepts at most."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 2**20


@dataclass(frozen=True)
class HttpLimits:
    """Sizes in bytes. A body is measured as sent; `decoded_bytes` and `decoded_ratio` bound what it decompresses to."""

    body_bytes: int = 32 * MIB
    json_bytes: int = 1 * MIB
    json_depth: int = 16
    decoded_bytes: int = 64 * MIB
    decoded_ratio: int = 100
    zstd_window_bytes: int = 8 * MIB
