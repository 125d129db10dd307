"""zstd and gzip with a cap on what comes out, decided while it comes out."""

from __future__ import annotations

import zlib

import zstandard

from revisit.core.errors import MalformedBody, TooLarge, UnsupportedEncoding
from revisit.formats.cloud import DEFAULT_LIMITS, CloudLimits

MAX_WINDOW_BYTES = 8 * 2**20
ALWAYS_ALLOWED_BYTES = 65_536
# One zstd block of 4 bytes may yield 128 KiB, so small pieces bound what one call can produce (16 MiB).
_PIECE_BYTES = 512


def decode_content(data: bytes, content_encoding: str | None, limits: CloudLimits = DEFAULT_LIMITS) -> bytes:
    """A body without its `Content-Encoding` (none, identity, gzip or zstd; one only).

    Raises UnsupportedEncoding for others, MalformedBody for damaged, truncated, trailing or multi-member data,
    TooLarge above `limits.max_decoded_bytes` or `limits.max_ratio`.
    """
    if len(data) > limits.max_body_bytes:
        raise TooLarge(f"a body may have {limits.max_body_bytes} bytes, got {len(data)}")
    match (content_encoding or "identity").strip().lower():
        case "identity":
            return data
        case "gzip":
            return _gunzip(data, _allowed(data, limits))
        case "zstd":
            return decompress_zstd(data, _allowed(data, limits))
    raise UnsupportedEncoding("Content-Encoding must be one of identity, gzip, zstd", field="Content-Encoding")


def decompress_zstd(data: bytes, max_bytes: int) -> bytes:
    """The content of one zstd frame without dictionary and with a window of at most 8 MiB.

    Raises MalformedBody, TooLarge above `max_bytes`.
    """
    try:
        _check_frame(data, max_bytes)
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW_BYTES).decompressobj()
        pieces, total = [], 0
        for start in range(0, len(data), _PIECE_BYTES):
            piece = decompressor.decompress(data[start : start + _PIECE_BYTES])
            total += len(piece)
            if total > max_bytes:
                raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")
            pieces.append(piece)
            if decompressor.eof:
                _require_end(decompressor.unused_data or data[start + _PIECE_BYTES :])
                return b"".join(pieces)
    except zstandard.ZstdError as error:
        raise MalformedBody("the zstd data is damaged") from error
    raise MalformedBody("the zstd data is truncated")


def _allowed(data: bytes, limits: CloudLimits) -> int:
    return min(limits.max_decoded_bytes, max(limits.max_ratio * len(data), ALWAYS_ALLOWED_BYTES))


def _check_frame(data: bytes, max_bytes: int) -> None:
    frame = zstandard.get_frame_parameters(data)
    if frame.dict_id or frame.window_size > max(MAX_WINDOW_BYTES, max_bytes):
        raise MalformedBody("the zstd frame needs a dictionary or a window above 8 MiB")
    if frame.content_size != zstandard.CONTENTSIZE_UNKNOWN and frame.content_size > max_bytes:
        raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")


def _gunzip(data: bytes, max_bytes: int) -> bytes:
    decompressor = zlib.decompressobj(wbits=31)
    try:
        content = decompressor.decompress(data, max_bytes + 1)
    except zlib.error as error:
        raise MalformedBody("the gzip data is damaged") from error
    if len(content) > max_bytes:
        raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")
    if not decompressor.eof:
        raise MalformedBody("the gzip data is truncated")
    _require_end(decompressor.unused_data)
    return content


def _require_end(rest: bytes) -> None:
    if rest:
        raise MalformedBody(f"{len(rest)} bytes follow the compressed data")
