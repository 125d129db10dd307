"""The bodies of the cloud rows G01-G58 by file name: each is a function, so that large ones are made when needed."""

from __future__ import annotations

import gzip
import io
import pickle
import struct
import zipfile
from collections.abc import Callable

import numpy as np
import zstandard

from tests.support.cloud_files import (
    ascii_body,
    npy_bytes,
    pcd_bytes,
    ply_bytes,
    records,
    valid_files,
)

Bodies = dict[str, Callable[[], bytes]]

MIB = 2**20
SUFFIXES = {
    "kitti": "bin",
    "pcd ascii": "ascii.pcd",
    "pcd binary": "pcd",
    "pcd compressed": "compressed.pcd",
    "ply ascii": "ascii.ply",
    "ply little": "ply",
    "ply big": "big.ply",
    "npy little": "npy",
    "npy big double": "double.npy",
    "pointcloud2": "pc2",
    "quantised": "rvq",
}
COUNTS = {"2pow31": "2147483648", "2pow32plus4": "4294967300", "2pow63": "9223372036854775808", "minus1": "-1"}
NUMBERS = {
    "1e400": "1e400",
    "hexadecimal": "0x10",
    "underscore": "1_0",
    "comma": "1,5",
    "arabic": "\u0663",
    "payload": "nan(0x1)",
}


def of_every_format(prefix: str, values: np.ndarray) -> Bodies:
    """One file a format, all with the (n, 4) `values`."""
    return {f"{prefix}.{suffix}": lambda kind=kind: valid_files(values)[kind][1] for kind, suffix in SUFFIXES.items()}


def points(values: np.ndarray) -> Callable[[], bytes]:
    """The (n, 3) or (n, 4) `values` as npy."""
    return lambda: npy_bytes(values.astype("<f4").tobytes(), shape=f"({values.shape[0]}, {values.shape[1]})")


def floats(count: int) -> bytes:
    """`count` points of four zeros."""
    return bytes(16 * count)


def pcd(body: bytes = floats(4), encoding: str = "binary", count: int = 4, **changes: str) -> Callable[[], bytes]:
    """A PCD with a fault."""
    return lambda: pcd_bytes(body, encoding, count, **changes)


def ply(
    body: bytes = floats(4), encoding: str = "binary_little_endian", count: int | str = 4, properties="", extra=""
) -> Callable[[], bytes]:
    """A PLY with a fault."""
    return lambda: ply_bytes(body, encoding, count, properties, extra)


def lzf(packed: bytes, packed_size: int | None = None, size: int = 64) -> Callable[[], bytes]:
    """A compressed PCD of four points with this body."""
    head = struct.pack("<II", len(packed) if packed_size is None else packed_size, size)
    return pcd(head + packed, "binary_compressed")


def quantised_zeros(count: int) -> bytes:
    """A quantised cloud whose points are all zero."""
    return struct.pack("<4sIffI", b"RVQ2", count, 0.001, 0.0, 0) + zstandard.compress(bytes(12 * count))


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> Callable[[], bytes]:
    """A zip archive, as npz and .pt files are."""

    def build() -> bytes:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, data in members.items():
                archive.writestr(zipfile.ZipInfo(name), data, method)
        return buffer.getvalue()

    return build


def saved(array: np.ndarray, **options) -> Callable[[], bytes]:
    """What `np.save` writes."""

    def build() -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, array, **options)
        return buffer.getvalue()

    return build


def changed(**columns: float) -> np.ndarray:
    """300 good points of which the first rows have other values: see the callers."""
    values = records(300)
    for count, value in ((int(name.removeprefix("first")), value) for name, value in columns.items()):
        values[:count, :3] = value
    return values


def sizes_and_values() -> Bodies:
    """G01-G15: how many points, and which numbers."""
    line = np.outer(np.arange(10_000), [0.01, 0.02, 0.005, 0.0])
    floor = np.column_stack([np.random.default_rng(3).uniform(-50, 50, (10_000, 2)), np.zeros((10_000, 2))])
    tiny = records(300)
    tiny[:9, :3], tiny[9:20, :3] = 1e-40, -0.0
    infinite = records(300)
    infinite[7, 1] = np.inf
    return {
        **of_every_format("good", records(120)),
        **{f"G01-empty.{suffix}": bytes for suffix in ("bin", "pcd", "ply", "npy", "pc2", "rvq")},
        **{name: body for name, body in of_every_format("G02-no-points", records(0)).items() if ".bin" not in name},
        **of_every_format("G03-one-point", records(1)),
        **of_every_format("G04-99-points", records(99)),
        **of_every_format("G05-100-points", records(100)),
        "G06-identical.npy": points(np.ones((10_000, 4))),
        "G07-collinear.npy": points(line),
        "G08-floor.npy": points(floor),
        "G09-5-percent-nan.npy": points(changed(first15=np.nan)),
        "G10-95-percent-nan.npy": points(changed(first285=np.nan)),
        "G11-one-infinity.npy": points(infinite),
        "G12-float32-max.npy": points(changed(first9=np.finfo("f4").max)),
        "G12-1e30.npy": points(records(300) * 1e28),
        "G13-utm.npy": points(records(300) + 1e5),
        "G14-denormals.npy": points(tiny),
        "G15-2000001-points.rvq": lambda: quantised_zeros(2_000_001),
    }


def wrong_counts() -> Bodies:
    """G16-G18: headers that promise more than there is."""
    bodies: Bodies = {
        "G16-100-million.rvq": lambda: struct.pack("<4sIffI", b"RVQ2", 10**8, 0.001, 0.0, 0) + bytes(48),
        "G16-100-million.pc2": lambda: valid_files(records(2))["pointcloud2"][1].replace(
            struct.pack("<II", 1, 2), struct.pack("<II", 10**8, 1)
        ),
        "G18-width-times-height.pcd": pcd(WIDTH="65536", HEIGHT="65537", POINTS="4"),
    }
    for name, count in {"G16-100-million": str(10**8), **{f"G17-{name}": c for name, c in COUNTS.items()}}.items():
        bodies[f"{name}.pcd"] = pcd(bytes(48), WIDTH=count, POINTS=count)
        bodies[f"{name}.compressed.pcd"] = pcd(bytes(48), "binary_compressed", WIDTH=count, POINTS=count)
        bodies[f"{name}.ply"] = ply(bytes(48), count=count)
        bodies[f"{name}.npy"] = lambda count=count: npy_bytes(bytes(48), shape=f"({count}, 4)")
    return bodies


def pcd_faults() -> Bodies:
    """G19-G32 but for the counts."""
    many = " ".join(f"f{number}" for number in range(5000))
    return {
        **{f"G19-size-{size.strip('-')}.pcd": pcd(SIZE=f"{size} 4 4 4") for size in ("3", "0", "-400")},
        **{f"G20-count-{count.strip('-')}.pcd": pcd(COUNT=f"{count} 1 1 1") for count in ("-1", "1073741824")},
        "G21-x-x-x.pcd": pcd(FIELDS="x x x y"),
        "G22-no-z.pcd": pcd(FIELDS="x y height intensity"),
        "G23-float-of-1-byte.pcd": pcd(SIZE="1 4 4 4"),
        "G23-type-q.pcd": pcd(TYPE="Q F F F"),
        "G24-row-missing.pcd": pcd(ascii_body(records(119)), "ascii", 120),
        "G25-row-too-many.pcd": pcd(ascii_body(records(121)), "ascii", 120),
        "G26-cut-in-a-row.pcd": pcd(records(120).tobytes()[:-7], count=120),
        "G27-short-uncompressed-size.pcd": lzf(b"\x03\x00\x00\x00\x00", size=4),
        "G28-packed-size.pcd": lzf(b"\x03\x00\x00\x00\x00", packed_size=0xFFFFFFF0),
        "G28-uncompressed-size.pcd": lzf(b"\x03\x00\x00\x00\x00", size=0xFFFFFFF0),
        "G29-before-the-start.pcd": lzf(b"\x20\x05"),
        "G29-output-overrun.pcd": lzf(b"\x1f" + bytes(32) + b"\xe0\xff\x00"),
        "G29-input-overrun.pcd": lzf(b"\x1f\x00"),
        "G30-line-of-1-mb.pcd": lambda: b"# .PCD " + b"x" * MIB + b"\n" + pcd_bytes(floats(4), "binary", 4),
        "G30-5000-fields.pcd": pcd(b"", count=0, FIELDS=many, SIZE=many, TYPE=many, COUNT=many),
        "G31-no-data.pcd": lambda: b"VERSION 0.7\nFIELDS x y z\n" * 4,
        **{
            f"G32-{name}.{kind}": write(f"{token} 0 0 0\n".encode() * 120, "ascii", 120)
            for name, token in NUMBERS.items()
            for kind, write in (("pcd", pcd), ("ply", ply))
        },
    }


def ply_faults() -> Bodies:
    """G33-G42."""
    faces = "element face 1\nproperty list uint int vertex_indices\n"
    listed = "property list uchar float x\nproperty float y\nproperty float z\n"
    mixed = "property float x\nproperty double y\nproperty uchar z\n"
    values = records(200) + 1.1
    return {
        "G33-name-of-100-kb.ply": ply(b"", "ascii", 0, properties=f"property float {'x' * 100_000}\n"),
        "G33-comment-of-2-mb.ply": ply(b"", "ascii", 0, extra=f"comment {'x' * (2 * MIB)}\n"),
        "G34-x-is-a-list.ply": ply((b"\x01" + bytes(12)) * 4, properties=listed),
        "G35-mixed-types.ply": ply(bytes(13 * 4), properties=mixed),
        "G36-two-vertex-elements.ply": ply(floats(8), extra="element vertex 4\n"),
        "G38-wrong-byte-order.ply": ply(values.astype(">f4").tobytes(), count=200),
        "G39-list-of-4-billion.ply": ply(floats(4) + b"\xff\xff\xff\xff" + bytes(12), extra=faces),
        "G40-20000-properties.ply": ply(
            bytes(20_000), count=1, properties="".join(f"property uchar p{number}\n" for number in range(20_000))
        ),
        "G41-ply.ply": lambda: b"ply\n\n",
        "G41-format.ply": lambda: b"ply\nformat\r\r",
        "G42-1599-bytes.bin": lambda: bytes(1599),
        "G42-17-bytes.bin": lambda: bytes(17),
    }


def npy_faults() -> Bodies:
    """G43-G50."""
    long_header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (120, 4), }" + b" " * 20_000 + b"\n"
    typed = {"f2": ("<f2", 2), "i4": ("<i4", 4), "u1": ("|u1", 1)}
    shapes = {"10pow12": "(1000000000000, 3)", "2pow62": "(4611686018427387904, 4)", "negative": "(-1, 3)"}
    return {
        "G43-pickled.npy": saved(np.array([{"a": 1}] * 3, dtype=object), allow_pickle=True),
        "G44-big-floats.npy": saved(records(120, ">f4")),
        "G44-doubles.npy": saved(records(120, "<f8")),
        **{f"G44-{name}.npy": lambda t=t, n=n: npy_bytes(bytes(480 * n), t) for name, (t, n) in typed.items()},
        **{
            f"G45-{name}.npy": lambda shape=shape: npy_bytes(floats(120), shape=shape)
            for name, shape in {**shapes, "true": "(True,)"}.items()
        },
        **{
            f"G46-{name}.npy": lambda descr=descr: npy_bytes(b"", descr, "(1000000000000,)")
            for name, descr in {"s0": "|S0", "v0": "|V0"}.items()
        },
        "G47-structured.npy": saved(np.zeros(3, dtype=[("x", "<f4"), ("y", "<f4", (2,))])),
        "G47-header-of-20-kb.npy": lambda: (
            b"\x93NUMPY\x02\x00" + struct.pack("<I", len(long_header)) + long_header + floats(120)
        ),
        "G47-unbalanced.npy": lambda: npy_bytes(floats(120), shape="(120, 4" + "(" * 400),
        "G48-bomb.npz": zipped({"points.npy": bytes(20 * MIB)}, zipfile.ZIP_DEFLATED),
        "G49-2000-entries.npz": zipped({f"a{number}.npy": b"" for number in range(2000)}),
        "G49-outside.npz": zipped({"../../x.npy": points(records(120))()}),
        "G50-no-npy.npz": zipped({"points.txt": b"1 2 3\n"}),
    }


def wrappings_and_other_files() -> Bodies:
    """G51-G58."""
    good = records(120).tobytes()
    zstd = zstandard.ZstdCompressor().compress
    wrapped = {"gzip": gzip.compress(good, 0, mtime=0), "zstd": zstd(good)}
    bodies: Bodies = {
        "G51-bomb.gzip": lambda: gzip.compress(bytes(40 * MIB), mtime=0),
        "G51-bomb.zstd": lambda: zstd(bytes(40 * MIB)),
        "G51-bomb-of-unknown-size.zstd": lambda: zstandard.ZstdCompressor(write_content_size=False).compress(
            bytes(40 * MIB)
        ),
        # Frame header descriptor 0 has no content size; window byte 0xa8 says 2 GiB. 0x01 announces a dictionary id.
        "G53-window-of-2-gib.zstd": lambda: b"\x28\xb5\x2f\xfd\x00\xa8\x01\x00\x00",
        "G53-dictionary.zstd": lambda: b"\x28\xb5\x2f\xfd\x01\x00\x07\x01\x00\x00",
        "G55-pickle-2": lambda: pickle.dumps({"points": [1.0, 2.0]}, protocol=2),
        "G55-pickle-4": lambda: pickle.dumps([1.0] * 30, protocol=4),
        "G55-model.pt": zipped({"archive/data.pkl": pickle.dumps([1.0], protocol=2)}),
        "G55-model.onnx": lambda: b"\x08\x07\x12\x07pytorch" + bytes(54),
        "G56-image.png": lambda: (
            b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x40\x00\x00\x00\x40\x00\x08\x02" + bytes(60)
        ),
        "G56-image.jpg": lambda: b"\xff\xd8\xff\xe0\x00\x10JFIF" + bytes(54),
        "G58-cloud.las": lambda: b"LASF" + bytes(371),
        "G58-cloud.e57": lambda: b"ASTM-E57" + bytes(40),
    }
    for name, data in wrapped.items():
        bodies[f"G52-whole.{name}"] = lambda data=data: data
        bodies[f"G52-truncated.{name}"] = lambda data=data: data[:-5]
        bodies[f"G52-garbage-behind.{name}"] = lambda data=data: data + b"garbage"
        bodies[f"G52-two-members.{name}"] = lambda data=data: data + data
    return bodies


def cloud_bodies() -> Bodies:
    """All of them."""
    parts = (sizes_and_values, wrong_counts, pcd_faults, ply_faults, npy_faults, wrappings_and_other_files)
    return {name: body for part in parts for name, body in part().items()}
