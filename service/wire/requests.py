"""Parts of request messages of `proto/revisit/v1` as the use cases take them, each written once."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, BadTransform, EmptyCloud, MalformedBody
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.formats import POINTCLOUD2, Encoding, PackedCloud, PointField
from revisit.service.domain import limits
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import EventKind
from revisit.service.features.catalogue.downloads import Download, DownloadKind
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.waiting.freshness import DEFAULT_WAIT_S, Freshness
from revisit.service.ports.map_tiles import Moment
from revisit.service.wire.fields import Fields
from revisit.v1 import cloud_pb2, event_pb2, geometry_pb2, ingest_pb2, loop_closure_pb2, map_tile_pb2, submap_pb2

StateT = TypeVar("StateT", bound=Enum)

_OF_SUBMAP: dict[int, tuple[DownloadKind, str | None]] = {
    submap_pb2.DownloadSubmapRequest.PCD: (DownloadKind.POINTS, "pcd"),
    submap_pb2.DownloadSubmapRequest.PLY: (DownloadKind.POINTS, "ply"),
    submap_pb2.DownloadSubmapRequest.NPY: (DownloadKind.POINTS, "npy"),
    submap_pb2.DownloadSubmapRequest.MESH: (DownloadKind.MESH, None),
    submap_pb2.DownloadSubmapRequest.GLB: (DownloadKind.MESH, "glb"),
    submap_pb2.DownloadSubmapRequest.NEURAL: (DownloadKind.NEURAL, None),
    submap_pb2.DownloadSubmapRequest.Format.Value("DESCRIPTOR"): (DownloadKind.DESCRIPTOR, None),  # else the message's
}
_OF_TILE: dict[int, tuple[DownloadKind, str | None]] = {
    map_tile_pb2.DownloadMapTileRequest.PCD: (DownloadKind.POINTS, "pcd"),
    map_tile_pb2.DownloadMapTileRequest.PLY: (DownloadKind.POINTS, "ply"),
    map_tile_pb2.DownloadMapTileRequest.NPY: (DownloadKind.POINTS, "npy"),
    map_tile_pb2.DownloadMapTileRequest.MESH: (DownloadKind.MESH, "ply"),
    map_tile_pb2.DownloadMapTileRequest.NEURAL: (DownloadKind.NEURAL, None),
    map_tile_pb2.DownloadMapTileRequest.GLB: (DownloadKind.MESH, "glb"),
}


def optional(message: Any, field: str) -> Any:
    """The value of a field, None where it is absent."""
    return getattr(message, field) if message.HasField(field) else None


def present(message: Any, *names: str) -> Fields:
    """Those of the fields that are not absent, by name."""
    return {name: getattr(message, name) for name in names if message.HasField(name)}


def page(request: Any) -> PageRequest:
    """Of any List request. Raises BadField."""
    return PageRequest(request.page_size or PageRequest().size, request.page_token)


def freshness(request: Any) -> Freshness:
    """The submaps that an answer must rest on. Raises BadField."""
    given = optional(request, "min_seq_timeout_s")
    return Freshness(request.min_seq, DEFAULT_WAIT_S if given is None else given)


def state_of(kind: type[StateT], enum: Any, value: int) -> StateT | None:
    """The state of a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else kind(_enum_name(enum, value))


def event_kinds(kinds: Iterable[int]) -> list[EventKind]:
    """Raises BadField for an unknown number."""
    return [EventKind(_enum_name(event_pb2.Event.Kind, kind)) for kind in kinds if kind]


def append_scan(session: SessionKey, scan: ingest_pb2.Scan) -> AppendScan:
    """The scan to append. Raises BadField, BadTransform, EmptyCloud, MalformedBody."""
    of = (session, scan.seq, scan.stamp_ns, pose(scan, "t_odom_sensor"), cloud(scan.cloud))
    return AppendScan(*of, travelled_m=optional(scan, "travelled_m"))


def download(file_format: int) -> tuple[DownloadKind, str | None]:
    """The form in which a submap is downloaded, and the file format where there is a choice. Raises BadField."""
    return _download(_OF_SUBMAP, file_format)


def tile_download(file_format: int) -> tuple[DownloadKind, str | None]:
    """As `download`, of a tile. Raises BadField."""
    return _download(_OF_TILE, file_format)


def moment(request: Any) -> Moment:
    """Which surface of a map is meant. Raises BadField."""
    as_of_ns = optional(request, "as_of_ns")
    if as_of_ns is not None:
        limits.STAMP_NS.validated(as_of_ns, "as_of_ns")
    return Moment(as_of_ns, request.ever)


def _download(known: dict[int, tuple[DownloadKind, str | None]], number: int) -> tuple[DownloadKind, str | None]:
    if number not in known:
        raise BadField("unknown download format", field="format")
    return known[number]


def chunks(file: Download) -> Iterator[Fields]:
    """A file as the fields of messages; the first one has its type."""
    yield {"media_type": file.media_type, "filename": file.filename}
    for piece in file.pieces():
        yield {"data": piece}


def cloud(message: cloud_pb2.Cloud) -> EncodedCloud:
    """The cloud, still encoded. Raises EmptyCloud where there is none, MalformedBody."""
    match message.WhichOneof("content"):
        case "encoded":
            return EncodedCloud(message.encoded.data, message.encoded.content_type)
        case "packed":
            return EncodedCloud(_packed_bytes(message.packed), POINTCLOUD2)
    raise EmptyCloud("the cloud is missing", field="cloud")


def vector(message: loop_closure_pb2.Descriptor) -> NDArray[np.float32]:
    """The vector (d,) of a descriptor."""
    return np.asarray(message.vector, dtype=np.float32)


def position(request: Any) -> tuple[float, float, float] | None:
    """The prior of a search, metres, None where there is none."""
    prior = optional(request, "prior_position_m")
    return None if prior is None else (prior.x, prior.y, prior.z)


def optional_pose(message: Any, field: str) -> Matrix4 | None:
    """The (4, 4) transform in `field`, None where it is absent. Raises BadTransform."""
    return pose(message, field) if message.HasField(field) else None


def pose(message: Any, field: str) -> Matrix4:
    """The (4, 4) transform in `field`, which errors name `T_...`. Raises BadTransform, also where it is missing."""
    if not message.HasField(field):
        raise BadTransform(f"T{field[1:]} is missing", field=f"T{field[1:]}")
    transform: geometry_pb2.Transform = getattr(message, field)
    q, t = transform.rotation, transform.translation
    return se3.from_quaternion((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def _packed_bytes(message: cloud_pb2.PackedCloud) -> bytes:
    point_fields = tuple(PointField(f.name, f.offset, f.datatype, f.count) for f in message.fields)
    quantised = message.encoding == cloud_pb2.PackedCloud.QUANTISED
    encoding = Encoding.QUANTISED if quantised else Encoding.RAW
    if not quantised and message.encoding > cloud_pb2.PackedCloud.RAW:
        raise BadField("the encoding of the packed cloud is unknown", field="encoding")
    if any(not field.name.isascii() or len(field.name) > 32 for field in point_fields):
        raise MalformedBody("names of fields are at most 32 ASCII characters")
    packed = PackedCloud(
        point_fields, message.point_stride, message.width, message.data, message.height, message.big_endian, encoding
    )
    try:
        return packed.to_bytes()
    except struct.error as error:
        raise MalformedBody("a number of the packed cloud's header is out of range") from error


def _enum_name(enum: Any, value: int) -> str:
    try:
        return str(enum.Name(value))
    except ValueError as error:
        raise BadField("unknown state", field="state") from error
