"""npy versions 1 and 2: a float32 or float64 array (n, 3) or (n, 4), of either byte order.

The header is matched by one regular expression, never evaluated; object arrays (pickle) are refused.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody, UnsupportedEncoding
from revisit.core.point_columns import INTENSITY, NONE, Columns, only
from revisit.formats.cloud import CloudLimits, DecodedCloud, records_for_writing, require_exact_size

MAGIC = b"\x93NUMPY"
MAX_HEADER_BYTES = 1024

_HEADER = re.compile(
    rb"\{ ?'descr': '(?P<descr>[<>|=]?[A-Za-z][0-9]{0,4})', 'fortran_order': (?P<order>True|False),"
    rb" 'shape': \((?P<shape>(?:[0-9]{1,19}, )*[0-9]{1,19},?|)\),? ?\} *\n"
)


def decode(data: bytes, limits: CloudLimits) -> DecodedCloud:
    """The array as points and, in a fourth column, intensity.

    Raises MalformedBody, UnsupportedEncoding for object arrays, BadField for another type or shape, TooLarge.
    """
    match, start = _read_header(data)
    descr, shape = match["descr"].decode("ascii"), tuple(int(size) for size in re.findall(rb"[0-9]+", match["shape"]))
    kind = descr.lstrip("<>|=")
    if kind.startswith("O"):
        raise UnsupportedEncoding("npy object arrays are pickles and are not accepted")
    size = _item_bytes(kind)
    require_exact_size(math.prod(shape) * size, len(data) - start, shape[0] if shape else 0, limits)
    if kind not in {"f4", "f8"} or descr[0] not in "<>":
        raise BadField(f"an npy cloud must be <f4, >f4, <f8 or >f8, got {descr}", field="points")
    if len(shape) != 2 or shape[1] not in (3, 4):
        raise BadField(f"an npy cloud must be (n, 3) or (n, 4), got {shape}", field="points")
    array = np.frombuffer(data, dtype=descr, offset=start).reshape(
        shape, order="F" if match["order"] == b"True" else "C"
    )
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.ascontiguousarray(array, dtype=np.float32)
    return DecodedCloud.of_table(values)


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """An npy version 1 file of float32 (n, 3), or (n, 4) with intensity, the one column that it has room for; of
    float64 where float32 does not hold a millimetre (`records_for_writing`).
    """
    records = records_for_writing(points, only(columns, (INTENSITY.name,)))
    kind = str(records.dtype["x"].str)
    values = np.column_stack([records[name] for name in records.dtype.fields or ()]).astype(kind)
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {values.shape}, }}".encode("ascii")
    header += b" " * (-(len(MAGIC) + 4 + len(header) + 1) % 64) + b"\n"
    return MAGIC + b"\x01\x00" + len(header).to_bytes(2, "little") + header + values.tobytes()


def _read_header(data: bytes) -> tuple[re.Match[bytes], int]:
    if not data.startswith(MAGIC) or len(data) < 12 or data[6:8] not in (b"\x01\x00", b"\x02\x00"):
        raise MalformedBody("the body is not an npy file of version 1 or 2")
    width = 2 if data[6] == 1 else 4
    length = int.from_bytes(data[8 : 8 + width], "little")
    start = 8 + width + length
    if length > MAX_HEADER_BYTES or start > len(data):
        raise MalformedBody(f"the npy header is longer than {MAX_HEADER_BYTES} bytes or than the body")
    match = _HEADER.fullmatch(data, 8 + width, start)
    if match is None:
        raise MalformedBody("the npy header does not describe one plain array")
    return match, start


def _item_bytes(kind: str) -> int:
    """Bytes an element of type `kind` (`f4`) takes. Raises MalformedBody for types without a fixed, known size."""
    sizes = {"f": {2, 4, 8, 16}, "i": {1, 2, 4, 8}, "u": {1, 2, 4, 8}, "c": {8, 16, 32}, "b": {1}}
    digits = kind[1:]
    if not digits or int(digits) not in sizes.get(kind[0], set()):
        raise MalformedBody(f"an npy array of type {kind} is not a cloud")
    return int(digits)
