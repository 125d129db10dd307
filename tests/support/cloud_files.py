"""Cloud files written by hand, so that no encoder of the product vouches for its own parser."""

from __future__ import annotations

import struct

import numpy as np

from revisit import formats


def lzf_compress(data: bytes) -> bytes:
    """LZF with literals and back-references, greedy over the last occurrence of each three bytes."""
    out, literals, seen, position = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            chunk = literals[start : start + 32]
            out.append(len(chunk) - 1)
            out.extend(chunk)
        literals.clear()

    while position < len(data):
        key = data[position : position + 3]
        start = seen.get(key, -1)
        seen[key] = position
        distance = position - start - 1
        if start < 0 or distance >= 8192 or len(key) < 3:
            literals.append(data[position])
            position += 1
            continue
        length = 3
        while position + length < len(data) and length < 264 and data[start + length] == data[position + length]:
            length += 1
        flush()
        if length - 2 < 7:
            out.append(((length - 2) << 5) | (distance >> 8))
        else:
            out.extend([(7 << 5) | (distance >> 8), length - 2 - 7])
        out.append(distance & 255)
        position += length
    flush()
    return bytes(out)


def pcd_bytes(body: bytes, encoding: str, points: int, **changes: str) -> bytes:
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z intensity",
        "SIZE": "4 4 4 4",
        "TYPE": "F F F F",
        "COUNT": "1 1 1 1",
        "WIDTH": str(points),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(points),
        "DATA": encoding,
    } | changes
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + body


def ply_bytes(body: bytes, encoding: str, vertices: int | str, properties: str = "", extra: str = "") -> bytes:
    properties = properties or "".join(f"property float {name}\n" for name in ("x", "y", "z", "intensity"))
    header = (
        f"ply\nformat {encoding} 1.0\ncomment hand made\nelement vertex {vertices}\n{properties}{extra}end_header\n"
    )
    return header.encode() + body


def npy_bytes(body: bytes, descr: str = "<f4", shape: str = "(120, 4)", order: str = "False") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    header += b" " * (63 - (10 + len(header)) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


def records(count: int = 120, dtype: str = "<f4") -> np.ndarray:
    """(count, 4) values that every format can hold exactly: eighths of a metre, intensities in 0..1."""
    rng = np.random.default_rng(7)
    values = rng.integers(-800, 800, (count, 4)) / 8.0
    values[:, 3] = rng.integers(0, 9, count) / 8.0
    return values.astype(dtype)


def ascii_body(values: np.ndarray) -> bytes:
    return "".join(" ".join(str(value) for value in row) + "\n" for row in values.tolist()).encode()


def compressed_body(values: np.ndarray) -> bytes:
    content = values.astype("<f4").T.tobytes()
    packed = lzf_compress(content)
    return struct.pack("<II", len(packed), len(content)) + packed


def valid_files(values: np.ndarray) -> dict[str, tuple[str, bytes]]:
    """One file of every kind, all with the same (n, 4) `values`."""
    little, big, n = values.astype("<f4").tobytes(), values.astype(">f4").tobytes(), len(values)
    field = b"".join(
        struct.pack("<32sIBBH", name, 4 * index, 7, 0, 1) for index, name in enumerate((b"x", b"y", b"z", b"intensity"))
    )
    rows = 2 if n % 2 == 0 else 1
    packed = struct.pack("<8sIIIHBB", b"\x89RVPC2\r\n", n // rows, rows, 16, 4, 0, 0) + field + little
    return {
        "kitti": (formats.KITTI, little),
        "pcd ascii": (formats.PCD, pcd_bytes(ascii_body(values), "ascii", n)),
        "pcd binary": (formats.PCD, pcd_bytes(little, "binary", n)),
        "pcd compressed": (formats.PCD, pcd_bytes(compressed_body(values), "binary_compressed", n)),
        "ply ascii": (formats.PLY, ply_bytes(ascii_body(values), "ascii", n)),
        "ply little": (formats.PLY, ply_bytes(little, "binary_little_endian", n)),
        "ply big": (formats.PLY, ply_bytes(big, "binary_big_endian", n)),
        "npy little": (formats.NPY, npy_bytes(little, shape=f"({n}, 4)")),
        "npy big double": (formats.NPY, npy_bytes(values.astype(">f8").tobytes(), ">f8", f"({n}, 4)")),
        "pointcloud2": (formats.POINTCLOUD2, packed),
        "quantised": (formats.QUANTISED, formats.encode_quantised(values[:, :3], {"intensity": values[:, 3]})),
    }
