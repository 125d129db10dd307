"""Bytes to points and back: strict parsers of our own, because file readers must never see a client's bytes.

    media type                             aliases                         module, content
    application/vnd.kitti.bin              application/x-kitti-bin         kitti: Velodyne scan
    application/vnd.pcd                    application/x-pcd, model/pcd    pcd: ascii, binary, binary_compressed
    model/ply                              application/vnd.ply, .../x-ply  ply: ascii, both byte orders
    application/vnd.npy                    application/x-npy               npy: float32/64 (n, 3) or (n, 4)
    application/vnd.revisit.pointcloud2                                    pointcloud2: packed PointCloud2
    application/vnd.revisit.quantised                                      quantised: 1 mm, differences, zstd

Parameters of a media type are ignored. `Content-Encoding` gzip or zstd may be put around any of them (`cloud`).
npz is not accepted: it is a zip of arrays, and npy says the same in fewer bytes.

One rule refuses most bad files: the declared size must equal the bytes present, checked in Python integers before
anything is allocated. Every failure is one of

    MalformedBody          the bytes break the format
    BadField               a valid file without usable x, y, z
    UnsupportedEncoding    unknown media type or encoding, or the magic bytes of another format
    TooLarge               more bytes or points than `CloudLimits` permits

Empty, non-finite, degenerate and far-away clouds are refused afterwards, by `core.scan.validate_cloud`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

from revisit.core.errors import MalformedBody, TooLarge, UnsupportedEncoding
from revisit.core.point_columns import USUAL
from revisit.formats import kitti, npy, pcd, ply, pointcloud2, quantised
from revisit.formats.cloud import DEFAULT_LIMITS, CloudLimits, DecodedCloud, decode_content
from revisit.formats.pointcloud2 import Encoding, FieldType, PackedCloud, PointField, decode_packed, pack

__all__ = [
    "KITTI",
    "MEDIA_TYPES",
    "NPY",
    "PCD",
    "PLY",
    "POINTCLOUD2",
    "QUANTISED",
    "CloudLimits",
    "DecodedCloud",
    "Encoding",
    "FieldType",
    "PackedCloud",
    "PointField",
    "count_quantised",
    "decode_cloud",
    "decode_content",
    "decode_packed",
    "encode_kitti",
    "encode_npy",
    "encode_pcd",
    "encode_ply",
    "encode_ply_mesh",
    "encode_pointcloud2",
    "encode_quantised",
    "media_type_for_suffix",
    "pack",
]

KITTI = "application/vnd.kitti.bin"
PCD = "application/vnd.pcd"
PLY = "model/ply"
NPY = "application/vnd.npy"
POINTCLOUD2 = "application/vnd.revisit.pointcloud2"
QUANTISED = "application/vnd.revisit.quantised"
MEDIA_TYPES = (KITTI, PCD, PLY, NPY, POINTCLOUD2, QUANTISED)

encode_kitti = kitti.encode
encode_npy = npy.encode
encode_pcd = pcd.encode
encode_ply = ply.encode
encode_ply_mesh = ply.encode_mesh
encode_pointcloud2 = pointcloud2.encode
encode_quantised = quantised.encode
count_quantised = quantised.count

_OF_FIELDS: dict[str, Callable[[bytes, CloudLimits, Collection[str]], DecodedCloud]] = {
    PCD: pcd.decode,
    PLY: ply.decode,
    POINTCLOUD2: pointcloud2.decode,
}
_OF_ROWS: dict[str, Callable[[bytes, CloudLimits], DecodedCloud]] = {
    KITTI: kitti.decode,
    NPY: npy.decode,
    QUANTISED: quantised.decode,
}
_ALIASES = {
    "application/x-kitti-bin": KITTI,
    "application/x-pcd": PCD,
    "model/pcd": PCD,
    "application/vnd.ply": PLY,
    "application/x-ply": PLY,
    "application/x-npy": NPY,
}
_SUFFIXES = {".bin": KITTI, ".pcd": PCD, ".ply": PLY, ".npy": NPY}

_MAGIC = {
    PCD: (b"# .PCD", b"VERSION "),
    PLY: (b"ply\n", b"ply\r"),
    NPY: (npy.MAGIC,),
    POINTCLOUD2: (pointcloud2.MAGIC,),
    QUANTISED: (quantised.MAGIC,),
}
# Files people send by mistake: zip (npz, torch, xlsx), LAS/LAZ, E57, PNG, JPEG, GIF, HDF5, gzip, zstd, bag, MCAP, PDF.
_FOREIGN_MAGIC = (
    *(b"PK\x03\x04", b"PK\x05\x06", b"LASF", b"ASTM-E57", b"\x89PNG", b"\xff\xd8\xff\xe0", b"\xff\xd8\xff\xe1"),
    *(b"GIF8", b"\x89HDF", b"\x1f\x8b\x08\x00", b"\x28\xb5\x2f\xfd", b"#ROSBAG", b"\x89MCAP", b"%PDF"),
)
# Pickles of protocol 2 to 5: the second opcode is one that a pickle really starts with, and the last one is STOP.
_PICKLE_STARTS = tuple(
    bytes([0x80, protocol]) + opcode for protocol in range(2, 6) for opcode in (b"\x95", b"c", b"}", b"]", b"(", b"X")
)


def decode_cloud(
    data: bytes,
    content_type: str,
    *,
    content_encoding: str | None = None,
    limits: CloudLimits = DEFAULT_LIMITS,
    wanted: Collection[str] = USUAL,
) -> DecodedCloud:
    """The cloud in a body of media type `content_type`, after undoing `content_encoding`.

    Of the fields of a file the columns (`core.point_columns`) that are `wanted` are read; of a quantised cloud, all.

    Raises UnsupportedEncoding, MalformedBody, BadField and TooLarge as the module says, nothing else.
    """
    media_type = resolve_media_type(content_type)
    body = decode_content(data, content_encoding, limits)
    if not body:
        raise MalformedBody("the body is empty")
    if len(body) > limits.max_decoded_bytes:
        raise TooLarge(f"a cloud may have {limits.max_decoded_bytes} bytes, got {len(body)}")
    _refuse_foreign_magic(body, media_type)
    if media_type in _OF_FIELDS:
        return _OF_FIELDS[media_type](body, limits, wanted)
    return _OF_ROWS[media_type](body, limits)


def resolve_media_type(content_type: str) -> str:
    """The canonical media type of a Content-Type header. Raises UnsupportedEncoding."""
    name = content_type.partition(";")[0].strip().lower()
    media_type = _ALIASES.get(name, name)
    if media_type not in MEDIA_TYPES:
        raise UnsupportedEncoding(f"the Content-Type must be one of {', '.join(MEDIA_TYPES)}", field="Content-Type")
    return media_type


def media_type_for_suffix(suffix: str) -> str:
    """The media type of files that end in `suffix` (`.pcd`). Raises UnsupportedEncoding."""
    if suffix.lower() not in _SUFFIXES:
        raise UnsupportedEncoding(f"cloud files end in one of {', '.join(_SUFFIXES)}, not in {suffix[:20]!r}")
    return _SUFFIXES[suffix.lower()]


def _refuse_foreign_magic(body: bytes, media_type: str) -> None:
    for other, magics in _MAGIC.items():
        if other != media_type and body.startswith(magics):
            raise UnsupportedEncoding(f"the body is {other}, the Content-Type says {media_type}", field="Content-Type")
    if body.startswith(_FOREIGN_MAGIC) or (body.startswith(_PICKLE_STARTS) and body.endswith(b".")):
        raise UnsupportedEncoding("the body is not a point cloud file", field="Content-Type")
