"""What every reader of foreign bytes promises, as functions of bytes that return nothing and raise only on a defect.

`test_targets.py` drives them with hypothesis; with atheris installed, `python -m tests.fuzz.targets NAME [FOLDER ...]`
drives one with libFuzzer, which takes further files and its own options as arguments.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from pathlib import Path

from revisit.api.calls import CALLS
from revisit.core.codec import neural_map as codec
from revisit.core.codec import place as place_form
from revisit.core.codec.mesh import unpack_mesh
from revisit.core.errors import DataLoss, RevisitError
from revisit.core.place import Place
from revisit.core.point_columns import COLUMNS, usable, validated
from revisit.core.scan import validate_cloud
from revisit.formats import MEDIA_TYPES, CloudLimits, PackedCloud, decode_cloud, decode_content
from revisit.formats.point_times import timed
from revisit.service.domain.identity import DEFAULT_TENANT
from revisit.service.features.ingest.clouds import unpack_cloud
from revisit.service.features.resources.paging import PageTokens
from revisit.service.rest.bodies import parse_json
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.request_form import form_of
from revisit.service.rest.schemas import SearchRequest

LIMITS = CloudLimits(max_decoded_bytes=2**20, max_points=20_000)
DIGEST_BYTES = 16
"""How much of the SHA-256 a place and a neural map end with."""

FILES = Path(__file__).resolve().parents[1] / "corpus/files"

Target = Callable[[bytes], None]


def cloud(media_type: str) -> Target:
    """A file of one media type: finite points in range, or a documented refusal."""

    def read(data: bytes) -> None:
        try:
            cloud = decode_cloud(data, media_type, limits=LIMITS, wanted=COLUMNS)
            points, report = validate_cloud(cloud.points)
            validated(usable(timed(cloud.columns, 10**18), cloud.points), points)
        except RevisitError as error:
            if isinstance(error, DataLoss):
                raise AssertionError("a client's bytes are no stored data") from error
            return
        if not 100 <= len(points) <= LIMITS.max_points or report.dropped_nonfinite < 0:
            raise AssertionError(f"{len(points)} points were accepted")

    return read


def content(encoding: str) -> Target:
    """A Content-Encoding: as many bytes as the limits allow, or a refusal."""

    def read(data: bytes) -> None:
        try:
            decoded = decode_content(data, encoding, LIMITS)
        except RevisitError:
            return
        if len(decoded) > LIMITS.max_decoded_bytes:
            raise AssertionError(f"{len(decoded)} bytes were accepted")

    return read


def refusing(reader: Callable[[bytes], object], *refusals: type[RevisitError]) -> Target:
    """A reader that answers or refuses with one of `refusals`."""

    def read(data: bytes) -> None:
        try:
            reader(data)
        except refusals:
            return

    return read


def behind_checksum(reader: Callable[[bytes], object], magic: bytes, digest_bytes: int) -> Target:
    """A stored reader that is given a fitting checksum, so that what lies behind it is reached."""

    def read(data: bytes) -> None:
        content = magic + data
        refusing(reader, DataLoss)(content + hashlib.sha256(content).digest()[:digest_bytes])

    return read


TOKENS = PageTokens(b"secret")

TARGETS: dict[str, Target] = {
    **{media_type: cloud(media_type) for media_type in MEDIA_TYPES},
    "gzip": content("gzip"),
    "zstd": content("zstd"),
    "packed cloud header": refusing(PackedCloud.from_bytes, RevisitError),
    "json map": refusing(lambda data: parse_json(data, form_of(CALLS["CreateMap"]).model, HttpLimits()), RevisitError),
    "json search": refusing(lambda data: parse_json(data, SearchRequest, HttpLimits()), RevisitError),
    "page token": refusing(lambda data: TOKENS.number_in(DEFAULT_TENANT, data.decode("latin-1")), RevisitError),
    "neural map": refusing(codec.unpack, DataLoss),
    "neural map behind its checksum": behind_checksum(codec.unpack, codec.CONTAINER.magic, DIGEST_BYTES),
    "place": refusing(Place.from_blob, DataLoss),
    "place behind its checksum": behind_checksum(Place.from_blob, place_form.MAGIC, DIGEST_BYTES),
    "stored cloud": refusing(unpack_cloud, DataLoss),
    "stored mesh": refusing(unpack_mesh, DataLoss),
}
"""By name. The last four read what the service itself has stored: damage to them is DATA_LOSS, never a crash."""


def main() -> None:
    """Fuzz the target that the first argument names with atheris, from the files of the corpus on."""
    import atheris

    name, *arguments = sys.argv[1:]
    atheris.instrument_all()
    atheris.Setup([sys.argv[0], str(FILES), *arguments], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
