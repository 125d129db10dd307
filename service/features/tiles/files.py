"""Tiles as files, in the frame of the map."""

from __future__ import annotations

from revisit.core.codec.tile import StoredTile
from revisit.core.errors import UnsupportedEncoding
from revisit.formats import encode_npy, encode_pcd, encode_ply, encode_ply_mesh
from revisit.formats.glb import encode_scene
from revisit.service.features.catalogue.downloads import MEDIA_TYPES, Download, DownloadKind
from revisit.service.ports.map_tiles import TileKey

FORMATS = {
    DownloadKind.MESH: ("ply", "glb"),
    DownloadKind.POINTS: ("pcd", "ply", "npy"),
    DownloadKind.NEURAL: ("rvn",),
}
"""The formats of each kind; the first is the default."""


def render_tile(blob: bytes, key: TileKey, kind: DownloadKind, file_format: str | None) -> Download:
    """A tile as a file. Raises UnsupportedEncoding, DataLoss."""
    extension = file_format or FORMATS[kind][0]
    if extension not in FORMATS[kind]:
        raise UnsupportedEncoding(f"{kind.value} can be had as {' or '.join(FORMATS[kind])}", field="format")
    name = f"{key.map_id}-{key.version}-{key.tile_id}-{kind.value}.{extension}"
    return Download(_rendered(StoredTile(blob), kind, extension), MEDIA_TYPES[extension], name)


def _rendered(tile: StoredTile, kind: DownloadKind, extension: str) -> bytes:
    if kind is DownloadKind.NEURAL:
        return tile.neural_map
    if kind is DownloadKind.POINTS:
        encode = {"pcd": encode_pcd, "ply": encode_ply, "npy": encode_npy}[extension]
        return encode(tile.points.vertices + tile.centre_m)
    mesh = tile.mesh
    if extension == "glb":
        return encode_scene(mesh.vertices, mesh.faces, tile.centre_m)
    return encode_ply_mesh(mesh.vertices + tile.centre_m, mesh.normals, mesh.faces)
