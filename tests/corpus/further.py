"""Further bad files, which are like some row of the corpus: given to the readers alone, not sent to a service."""

from __future__ import annotations

import struct
from dataclasses import replace

from revisit import formats
from tests.corpus.clouds import COUNTS, Bodies, floats, lzf, npy_bytes, pcd, ply
from tests.support.cloud_files import ascii_body, records

BROKEN_LZF = {"ends-in-a-reference": b"\x00\x00\xe0", "short-of-size": b"\x03\x00\x00\x00\x00"}
HEADERS = {
    "count-0": {"COUNT": "0 1 1 1"},
    "three-names": {"FIELDS": "x y z"},
    "data": {"DATA": "binary_zipped"},
    "width": {"WIDTH": "5"},
    "two-numbers": {"POINTS": "4 4"},
}
LAYOUTS = {
    "no-fields": {"fields": ()},
    "field-behind-the-point": {"fields": (formats.PointField("x", 13, 7),)},
    "unknown-type": {"fields": (formats.PointField("x", 0, 9),)},
    "no-values": {"fields": (formats.PointField("x", 0, 7, 0),)},
    "two-of-a-name": {"fields": (formats.PointField("x", 0, 7), formats.PointField("x", 4, 7))},
    "no-step": {"point_step": 0},
    "other-width": {"width": 5},
}
NUMBERS = ("infinit", "1e", "--1", "1" * 65)


def counts() -> Bodies:
    """Counts that the body cannot hold, and that are none, in the encodings that the corpus leaves out."""
    made: Bodies = {}
    for name, count in {**COUNTS, "100-million": str(10**8), "1e3": "1e3", "arabic": "\u0663"}.items():
        for encoding in ("binary", "ascii", "binary_compressed"):
            made[f"{name}-{encoding}.pcd"] = pcd(bytes(48), encoding, 0, WIDTH=count, POINTS=count)
        for encoding in ("binary_little_endian", "binary_big_endian", "ascii"):
            made[f"{name}-{encoding}.ply"] = ply(bytes(48), encoding, count)
        made[f"{name}.npy"] = lambda count=count: npy_bytes(bytes(48), shape=f"({count}, 4)")
    return made


def lengths() -> Bodies:
    """Bodies longer or shorter than declared."""
    made: Bodies = {f"{length}-bytes.bin": lambda length=length: bytes(length) for length in (1, 15)}
    for change in (-7, -16, 1, 16):
        body = floats(8)[:change] if change < 0 else floats(8) + bytes(change)
        made[f"length{change:+}.pcd"] = pcd(body, count=8)
        made[f"length{change:+}.ply"] = ply(body, count=8)
        made[f"length{change:+}.npy"] = lambda body=body: npy_bytes(body, shape="(8, 4)")
    for rows in (3, 5):
        made[f"{rows}-rows-of-4.pcd"] = pcd(ascii_body(records(rows)), "ascii")
        made[f"{rows}-rows-of-4.ply"] = ply(ascii_body(records(rows)), "ascii")
    return made | {"borrowed-number.pcd": pcd(b"1 2 3\n4 5 6 7 8\n", "ascii", 2)}


def malformed_pcd_and_ply() -> Bodies:
    """Headers, compressed bodies and numbers."""
    faces = "element face 1\nproperty list uint int vertex_indices\n"
    endless = b"\xff\xff\xff\xff" + bytes(12)
    return {
        **{f"header-{name}.pcd": pcd(**changes) for name, changes in HEADERS.items()},
        **{f"lzf-{name}.pcd": lzf(packed) for name, packed in BROKEN_LZF.items()},
        "two-bytes-of-lzf.pcd": pcd(b"\x00\x00", "binary_compressed"),
        **{f"number-{token[:9]}.pcd": pcd(f"{token} 0 0 0\n".encode(), "ascii", 1) for token in NUMBERS},
        **{f"number-{token[:9]}.ply": ply(f"{token} 0 0 0\n".encode(), "ascii", 1) for token in NUMBERS},
        **{
            f"number-{name}-behind-inf.pcd": pcd(f"inf 0 0 0\n0 {token} 0 0\n".encode(), "ascii", 2)
            for name, token in {"1e400": "1e400", "hexadecimal": "0x10", "comma": "1,5", "two-signs": "--1"}.items()
        },
        "endless-header.pcd": lambda: b"# .PCD\nFIELDS x\n" * 1000,
        "endless-lines.pcd": lambda: b"\n" * 100_000,
        "endless-header.ply": lambda: b"ply\nformat ascii 1.0\n" + b"comment\n" * 5001,
        "stump.ply": lambda: b"ply\r",
        "version-2.ply": lambda: b"ply\nformat ascii 2.0\nend_header\n",
        "list-of-4-billion.big.ply": ply(floats(4) + endless, "binary_big_endian", extra=faces),
        "list-of-4-billion.ascii.ply": ply(ascii_body(records(4)) + b"4294967295 1 2\n", "ascii", extra=faces),
    }


def malformed_others() -> Bodies:
    """npy, packed and quantised clouds."""
    four, quantised = records(4), formats.encode_quantised(records()[:, :3])
    wide = formats.PackedCloud((formats.PointField("x", 0, 7),), 16, 65536, floats(4), height=65537)
    layouts = {
        name: replace(formats.pack(four[:, :3], {"intensity": four[:, 3]}), **change)
        for name, change in LAYOUTS.items()
    }
    steps = {"zero": 0.0, "negative": -1.0, "nan": float("nan"), "infinite": float("inf")}
    return {
        "10-pow-30.npy": lambda: npy_bytes(floats(120), shape=f"(1{'0' * 30}, 3)"),
        **{f"type-{d[1:]}.npy": lambda d=d: npy_bytes(b"", d, "(1000000000000,)") for d in ("|S4", "<U1", "<M8")},
        "version-3.npy": lambda: b"\x93NUMPY\x03\x00" + bytes(20),
        **{f"layout-{name}.pc2": packed.to_bytes for name, packed in {**layouts, "width-times-height": wide}.items()},
        **{
            f"step-{name}.rvq": lambda step=step: quantised[:8] + struct.pack("<f", step) + quantised[12:]
            for name, step in steps.items()
        },
        "one-point-too-few.rvq": lambda: quantised[:4] + struct.pack("<I", 121) + quantised[8:],
    }


def bad_fields() -> Bodies:
    """Sound files whose values are no coordinates."""
    shapes = {"(120,)": 120, "(120, 2)": 240, "(40, 3, 4)": 480, "(1, 480)": 480, "()": 1}
    return {
        "integers.pcd": pcd(TYPE="I I I F"),
        "no-z.ply": ply(bytes(32), properties="property float x\nproperty float y\n"),
        "complex.npy": lambda: npy_bytes(bytes(480 * 8), "<c8"),
        "truths.npy": lambda: npy_bytes(bytes(480), "|b1"),
        **{f"shape-{s}.npy": lambda s=s, n=n: npy_bytes(bytes(4 * n), shape=s) for s, n in shapes.items()},
    }


def further_bodies() -> dict[str, Bodies]:
    """By the reason of their refusal; the suffix names the media type, as in the corpus."""
    malformed = counts() | lengths() | malformed_pcd_and_ply() | malformed_others()
    unknown = {"encoding-7.pc2": replace(formats.pack(records(4)[:, :3]), encoding=7).to_bytes}
    return {
        "MALFORMED_BODY": malformed,
        "BAD_FIELD": bad_fields(),
        "UNSUPPORTED_ENCODING": unknown,
    }
