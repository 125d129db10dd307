"""A submap as a file."""

from __future__ import annotations

import io
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.mesh import Mesh
from revisit.core.errors import UnsupportedEncoding
from revisit.core.point_columns import COLUMNS, TIME, Columns
from revisit.formats import NPY, PCD, PLY, encode_npy, encode_pcd, encode_ply, encode_ply_mesh
from revisit.formats.glb import MEDIA_TYPE as GLB
from revisit.formats.glb import encode_scene
from revisit.service.domain.errors import NotFound, NotKept, NotReady
from revisit.service.domain.records import SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.features.ingest.clouds import StoredCloud, unpack_cloud
from revisit.service.features.ingest.rows import SubmapSource, load_submap, require_scans
from revisit.service.ports.blobs import CLOUD_BLOB, NEURAL_MAP_BLOB, BlobStore
from revisit.service.ports.storage import require_descriptor


class DownloadKind(StrEnum):
    """Downloads of a submap."""

    MESH = "mesh"
    POINTS = "points"
    NEURAL = "neural"
    DESCRIPTOR = "descriptor"


FORMATS = {
    DownloadKind.MESH: ("ply", "glb"),
    DownloadKind.POINTS: ("pcd", "ply", "npy"),
    DownloadKind.NEURAL: ("rvn",),
    DownloadKind.DESCRIPTOR: ("npy",),
}
"""The formats of each kind; the first is the default."""

MEDIA_TYPES = {
    "ply": PLY,
    "pcd": PCD,
    "npy": NPY,
    "glb": GLB,
    "rvn": "application/vnd.revisit.neural-map",
}


RENDERING_BYTES = 48 * 2**20
"""A file's share of the budget until its size is known: as much as 2,000,000 points."""

Room = Callable[[int], Awaitable[None]]
"""Waits until the budget has room for so many bytes of a file. Raises WorkersBusy."""

PIECE_BYTES = 2**18
"""A file is sent in pieces: the next is handed over once the client has taken most of the one before."""


@dataclass(frozen=True)
class Download:
    """A file: its bytes, media type and a name to save it under."""

    data: bytes
    media_type: str
    filename: str

    def pieces(self) -> Iterator[bytes]:
        """The file in pieces of `PIECE_BYTES`."""
        for start in range(0, len(self.data), PIECE_BYTES):
            yield self.data[start : start + PIECE_BYTES]


async def any_room(count: int) -> None:
    """The `Room` of a caller that is no client of the gateway."""


def extension_of(kind: DownloadKind, file_format: str | None) -> str:
    """The format asked for, or that of the kind. Raises UnsupportedEncoding."""
    extension = file_format or FORMATS[kind][0]
    if extension not in FORMATS[kind]:
        raise UnsupportedEncoding(f"{kind.value} can be had as {' or '.join(FORMATS[kind])}", field="format")
    return extension


def named(data: bytes, record: SubmapRecord, kind: DownloadKind, extension: str) -> Download:
    """A file of a submap with its media type and name."""
    return Download(data, MEDIA_TYPES[extension], f"{record.session_id}-{record.submap_id}-{kind.value}.{extension}")


def require_neural_map(record: SubmapRecord) -> str:
    """The hash of a submap's neural map.

    Raises NotReady before it is described, NotKept where retention has removed it, NotFound where it never had one.
    """
    if record.state not in (SubmapState.DESCRIBED, SubmapState.RETIRED):
        raise NotReady
    if record.neural_map_sha256 is None and record.state == SubmapState.RETIRED:
        raise NotKept(f"the neural map of {record.submap_id} is not kept: its map's policy of retention removed it")
    if record.neural_map_sha256 is None:
        raise NotFound("this submap was described without a neural map")
    return record.neural_map_sha256


def mesh_file(mesh: Mesh, extension: str) -> bytes:
    """A mesh as PLY, or as GLB with meshopt."""
    if extension == "glb":
        return encode_scene(mesh.vertices, mesh.faces)
    return encode_ply_mesh(mesh.vertices, mesh.normals, mesh.faces)


def stored_file(
    blobs: BlobStore, record: SubmapRecord, source: SubmapSource, kind: DownloadKind, extension: str
) -> bytes:
    """The file of anything but a mesh. Raises NotReady, NotFound, DataLoss."""
    if kind is DownloadKind.POINTS:
        return _points_file(_points(blobs, record, source), extension)
    if kind is DownloadKind.NEURAL:
        return blobs.get(record.tenant, NEURAL_MAP_BLOB, require_neural_map(record))
    buffer = io.BytesIO()
    np.save(buffer, np.frombuffer(require_descriptor(record), dtype="<f4"), allow_pickle=False)
    return buffer.getvalue()


def _points(blobs: BlobStore, record: SubmapRecord, source: SubmapSource) -> StoredCloud:
    """The points with their columns; times are seconds since 1970 in the clock of the robot, float64."""
    require_scans(record)
    if source.posted:
        cloud = unpack_cloud(blobs.get(record.tenant, CLOUD_BLOB, source.clouds[0].cloud_sha256))
        return StoredCloud(cloud.points, _on_the_clock(cloud.columns, np.int64(record.stamp_ns)))
    submap = load_submap(blobs, record, source, COLUMNS)
    return StoredCloud(submap.points, _on_the_clock(submap.columns, submap.stamps_ns[submap.scan_index]))


def _on_the_clock(columns: Columns, stamps_ns: np.int64 | NDArray[np.int64]) -> Columns:
    """The columns with the time of each point on the clock, where they have the time since its stamp."""
    if TIME.name not in columns:
        return columns
    return {**columns, TIME.name: (stamps_ns + columns[TIME.name]) / 1e9}


def _points_file(cloud: StoredCloud, extension: str) -> bytes:
    encode = {"pcd": encode_pcd, "ply": encode_ply, "npy": encode_npy}[extension]
    return encode(cloud.points, cloud.columns)
