"""Content-Encoding gzip and zstd, decompressed within bounds that a bomb cannot pass."""

from __future__ import annotations

import zlib

import zstandard

from core.errors import MalformedBody, TooLarge, UnsupportedEncoding
from service.rest.limits import HttpLimits

_STEP_BYTES = 256
"""A zstd block of 4 bytes can stand for 128 KiB, so one step of input grows to at most 8 MiB."""


def decompress(data: bytes, encoding: str, limits: HttpLimits) -> bytes:
    """The body without its Content-Encoding: "", "identity", "gzip" or "zstd".

    Raises UnsupportedEncoding for another, MalformedBody for damage, truncation or trailing bytes, TooLarge where the
    body decompresses to more than the limits allow.
    """
    if encoding in ("", "identity"):
        return data
    if encoding not in ("gzip", "zstd"):
        raise UnsupportedEncoding("Content-Encoding must be gzip, zstd or absent")
    limit = min(limits.decoded_bytes, max(1, len(data)) * limits.decoded_ratio)
    return _gunzip(data, limit) if encoding == "gzip" else _unzstd(data, limit, limits.zstd_window_bytes)


def _gunzip(data: bytes, limit: int) -> bytes:
    decoder = zlib.decompressobj(wbits=31)
    try:
        decoded = decoder.decompress(data, limit + 1)
    except zlib.error as error:
        raise MalformedBody("the body is not gzip") from error
    if len(decoded) > limit:
        raise _bomb()
    if not decoder.eof or decoder.unused_data:
        raise MalformedBody("the gzip body is truncated or followed by other bytes")
    return decoded


def _unzstd(data: bytes, limit: int, window_bytes: int) -> bytes:
    decoder = zstandard.ZstdDecompressor(max_window_size=window_bytes).decompressobj()
    decoded = bytearray()
    try:
        for start in range(0, len(data), _STEP_BYTES):
            if decoder.eof:
                raise MalformedBody("the zstd body is followed by other bytes")
            decoded += decoder.decompress(data[start : start + _STEP_BYTES])
            if len(decoded) > limit:
                raise _bomb()
    except zstandard.ZstdError as error:
        raise MalformedBody("the body is not a zstd frame this service reads") from error
    if not decoder.eof or decoder.unused_data:
        raise MalformedBody("the zstd body is truncated or followed by other bytes")
    return bytes(decoded)


def _bomb() -> TooLarge:
    return TooLarge("the body decompresses to more than this service accepts")
