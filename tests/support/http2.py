"""HTTP/2 frames by hand, for clients that no library would let one write."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY = 0x1, 0x3, 0x4, 0x6, 0x7
END_HEADERS = 0x4
CANCEL = struct.pack(">I", 8)
_HEAD_BYTES = 9


def frame(kind: int, payload: bytes = b"", *, flags: int = 0, stream: int = 0) -> bytes:
    """One frame."""
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


OPENING = PREFACE + frame(SETTINGS)
"""What a client begins with."""


def call_headers(method: str, stream: int) -> bytes:
    """The HEADERS frame that begins a gRPC call of `/package.Service/Method`; HPACK literals without a table."""
    literals = ((b"\x04", method.encode()), (b"\x01", b"localhost"), (b"\x0f\x10", b"application/grpc"))
    block = b"\x83\x86" + b"".join(name + bytes([len(value)]) + value for name, value in literals)
    block += b"\x00\x02te\x08trailers"
    return frame(HEADERS, block, flags=END_HEADERS, stream=stream)


def frames(connection: socket.socket) -> Iterator[tuple[int, bytes]]:
    """Kind and payload of the frames that come, until the connection is closed or its timeout passes."""
    received = b""
    with contextlib.suppress(OSError):
        while data := connection.recv(65536):
            received += data
            while len(received) >= (end := _HEAD_BYTES + int.from_bytes(received[:3], "big")) and end >= _HEAD_BYTES:
                if len(received) < _HEAD_BYTES:
                    break
                yield received[3], received[_HEAD_BYTES:end]
                received = received[end:]
