"""Generate the Python stubs of `proto/revisit/v1` into the package `revisit.v1`: `python proto/generate.py [OUT]`.

OUT is the folder that holds (or will hold) `revisit/v1`, the repository root unless given.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from grpc_tools import protoc  # type: ignore[import-untyped]

PROTO = Path(__file__).resolve().parent


def generate(out: Path) -> None:
    """Write `*_pb2.py`, `*_pb2.pyi` and, for files with services, `*_pb2_grpc.py` under `out`."""
    sources = sorted(PROTO.glob("revisit/v1/*.proto"))
    services = [path for path in sources if re.search(r"^service ", path.read_text(), re.MULTILINE)]
    include = f"-I{PROTO}"
    well_known = f"-I{Path(protoc.__file__).parent / '_proto'}"
    _run("protoc", include, well_known, f"--python_out={out}", f"--pyi_out={out}", *map(str, sources))
    _run("protoc", include, well_known, f"--grpc_python_out={out}", *map(str, services))


def _run(*arguments: str) -> None:
    if protoc.main(arguments) != 0:
        raise SystemExit("protoc failed")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else PROTO.parent)
