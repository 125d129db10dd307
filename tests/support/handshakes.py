"""Beginnings of handshakes that never end."""

from __future__ import annotations

import contextlib
import ssl


def half_hello() -> bytes:
    """The first half of what a TLS client begins with."""
    sent = ssl.MemoryBIO()
    client = ssl.create_default_context().wrap_bio(ssl.MemoryBIO(), sent, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    hello = sent.read()
    return hello[: len(hello) // 2]
