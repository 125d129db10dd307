"""Received clouds: decoded if they are encoded, validated, and packed for storage."""

from __future__ import annotations

import asyncio
import re
import struct
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import partial
from typing import ParamSpec, TypeAlias, TypeVar

import numpy as np
import zstandard

from revisit.core.codec.container import decompressed, from_byte_planes, to_byte_planes
from revisit.core.errors import DataLoss, FormerForm, RevisitError, TooLarge
from revisit.core.point_columns import COLUMNS, INTENSITY, Columns, only, validated
from revisit.core.scan import CloudReport, Points, validate_cloud
from revisit.formats import CloudLimits, DecodedCloud, decode_cloud, quantised
from revisit.formats.cloud import DEFAULT_LIMITS, decode_content
from revisit.service.capacity.in_flight import Turns
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId

QUERY_NONCE_BYTES = 16

BYTES_A_POINT = 4
"""So many bytes of text take as long to read as one point of a binary cloud, its packing included."""

STORED_LIMITS = CloudLimits(max_points=limits.SUBMAP_POINTS)
"""Of a stored cloud: it was let in, so only damage makes it larger."""

P = ParamSpec("P")
T = TypeVar("T")

_MAGIC = b"RVC1"
_FORMER_MAGIC = b"RVQ1"
_HEADER = struct.Struct("<4sIB")
_HEADER_BYTES = 64 * 2**10
# The line of a PCD or PLY header that says so.
_ASCII_HEADER = re.compile(rb"^(DATA|format)[ \t]+ascii", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True)
class EncodedCloud:
    """Bytes as the client sent them, with their content type.

    `coding` is the compression that is still on them (`gzip`, `zstd`): it is removed when the cloud's turn to be
    decoded comes, so that a cloud that waits keeps its small form.
    """

    data: bytes
    content_type: str
    coding: str | None = None


CloudInput: TypeAlias = EncodedCloud | DecodedCloud


@dataclass(frozen=True)
class StoredCloud:
    """The stored part of a cloud: finite points (n, 3) float32 metres in the sensor frame, and the columns sent.

    `quantised`: the same as the client sent it, where it came in that form.
    """

    points: Points
    columns: Columns = field(default_factory=dict)
    quantised: bytes | None = None


def accept_cloud(cloud: CloudInput, max_points: int) -> tuple[StoredCloud, CloudReport]:
    """Decode where needed, validate, and keep the finite points with their columns.

    Raises as `revisit.formats.decode_cloud`, `core.scan.validate_cloud` and `point_columns.validated` do, and TooLarge
    above `max_points`.
    """
    decoded, sent = _decoded(cloud)
    if len(decoded.points) > max_points:
        raise TooLarge(f"a cloud may hold {max_points} points here, got {len(decoded.points)}", field="points")
    points, report = validate_cloud(decoded.points)
    columns = validated(decoded.columns, decoded.points) if decoded.columns else {}
    return StoredCloud(points, columns, sent), report


def reading_points(cloud: CloudInput) -> int:
    """The most that reading a refused cloud costs, in points of an accepted one."""
    if not isinstance(cloud, EncodedCloud):
        return len(cloud.points)
    ratio = DEFAULT_LIMITS.max_ratio if cloud.coding else 1
    return min(ratio * len(cloud.data), DEFAULT_LIMITS.max_decoded_bytes) // BYTES_A_POINT


class CloudDecoder:
    """Decodes clouds beside the event loop, as many at a time as there are threads; tenants take turns.

    A cloud keeps a core busy, up to a fifth of a second and compressed text for longer. A tenant that sends many waits
    for its own ones, and the others do not: one thread is left to them.
    """

    def __init__(self, threads: int) -> None:
        """Clouds beyond `threads` wait for their turn."""
        self._pool = ThreadPoolExecutor(threads, "decode")
        self._turns = Turns(threads, of_tenant=max(1, threads - 1))

    async def run(self, tenant: TenantId, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run `work` for `tenant` in one of the threads, with the context of the request."""
        in_context = partial(copy_context().run, work, *args, **kwargs)
        async with self._turns.of(tenant):
            return await asyncio.get_running_loop().run_in_executor(self._pool, in_context)


def pack_cloud(cloud: StoredCloud) -> bytes:
    """The cloud as a compact, lossless blob: as it was sent, where it is quantised and no larger than its numbers.

    Else quantised where it has other columns than intensity, which come in that form alone; else a header, then the
    byte planes of its float32 numbers under zstd.
    """
    columns, intensity = dict(cloud.columns), cloud.columns.get(INTENSITY.name)
    bytes_a_point = 12 + sum(4 * COLUMNS[name].channels for name in columns)
    if cloud.quantised is not None and len(cloud.quantised) <= bytes_a_point * len(cloud.points):
        return cloud.quantised
    if columns.keys() - {INTENSITY.name}:
        return quantised.encode(cloud.points, columns)
    values = cloud.points if intensity is None else np.column_stack([cloud.points, intensity])
    table = np.ascontiguousarray(values, dtype="<f4")
    header = _HEADER.pack(_MAGIC, len(table), table.shape[1])
    return header + zstandard.ZstdCompressor(level=1).compress(to_byte_planes(table))


def unpack_cloud(blob: bytes, wanted: Collection[str] = tuple(COLUMNS)) -> StoredCloud:
    """The cloud of `pack_cloud` with the columns that are `wanted`. Raises FormerForm, DataLoss for anything else."""
    if blob.startswith(quantised.MAGIC):
        return _dequantised(blob, wanted)
    if blob.startswith(_FORMER_MAGIC):
        raise FormerForm("stored cloud", "its robot has to send it again")
    try:
        magic, count, width = _HEADER.unpack_from(blob)
        size = count * width * 4
        if magic != _MAGIC or width not in (3, 4) or count > limits.SUBMAP_POINTS:
            raise DataLoss("a stored cloud has a damaged header")
    except struct.error as error:
        raise DataLoss("a stored cloud is damaged") from error
    data = decompressed(blob[_HEADER.size :], size, "stored cloud")
    if len(data) != size:
        raise DataLoss("a stored cloud is incomplete")
    table = from_byte_planes(data, width, "<f4").astype(np.float32)
    cloud = DecodedCloud.of_table(table)
    return StoredCloud(cloud.points, only(cloud.columns, wanted))


def _dequantised(blob: bytes, wanted: Collection[str]) -> StoredCloud:
    try:
        cloud = quantised.decode(blob, STORED_LIMITS, wanted)
    except RevisitError as error:
        raise DataLoss("a stored cloud is damaged") from error
    return StoredCloud(cloud.points, cloud.columns)


def _decoded(cloud: CloudInput) -> tuple[DecodedCloud, bytes | None]:
    """The cloud, and the bytes that it was decoded from where they are quantised."""
    if not isinstance(cloud, EncodedCloud):
        return cloud, None
    data = decode_content(cloud.data, cloud.coding)
    if len(data) > limits.ASCII_CLOUD_BYTES and _ASCII_HEADER.search(data, 0, _HEADER_BYTES):
        raise TooLarge(f"an ASCII cloud may have {limits.ASCII_CLOUD_BYTES} bytes; send the binary form of the format")
    return decode_cloud(data, cloud.content_type), data if data.startswith(quantised.MAGIC) else None
