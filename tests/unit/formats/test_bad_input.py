"""Bad files: what a row of the corpus that a reader decides must be refused for, and files like those of a row."""

from __future__ import annotations

import tracemalloc
from functools import cache

import pytest
import zstandard

from revisit import formats
from revisit.core.errors import RevisitError, TooLarge
from revisit.core.scan import validate_cloud
from revisit.formats import KITTI, PCD, CloudLimits, decode_cloud
from tests.corpus.clouds import COUNTS
from tests.corpus.further import counts, further_bodies
from tests.corpus.rows import MEDIA_TYPES, cases
from tests.corpus.write import bodies, body_of
from tests.support.cloud_files import compressed_body, pcd_bytes, records, valid_files


def refusals():
    """Each bad file with its media type, content encoding and the reasons of which one must be given."""
    for case in cases():
        if case.row.startswith("G") and case.http and case.http[0] >= 400:
            for cloud in case.clouds:
                yield pytest.param(cloud.body, cloud.type, cloud.encoding, case.http[1], id=f"{case.id}-{cloud.body}")
    for reason, names in further_bodies().items():
        for name in names:
            yield pytest.param(name, MEDIA_TYPES[name.rpartition(".")[2]], None, reason, id=name)


FURTHER = {name: body for more in further_bodies().values() for name, body in more.items()}


@cache
def data_of(name: str) -> bytes:
    return FURTHER[name]() if name in FURTHER else body_of(name)


def reason_for(data: bytes, media_type: str, **options) -> str:
    """Why a body is refused. Raises AssertionError where it is not; python -O drops no check of this file."""
    try:
        validate_cloud(decode_cloud(data, media_type, **options).points)
    except RevisitError as error:
        return error.code.value
    raise AssertionError("it is taken")


def require_reason(reasons: str, data: bytes, media_type: str, **options) -> None:
    reason = reason_for(data, media_type, **options)
    if reason not in reasons.split("|"):
        raise AssertionError(f"{reason}, not {reasons}")


@pytest.mark.parametrize(("name", "media_type", "encoding", "reasons"), list(refusals()))
def test_a_bad_file_is_refused_for_the_reason_of_its_row(name, media_type, encoding, reasons):
    require_reason(reasons, data_of(name), media_type, content_encoding=encoding)


def _most_traced_bytes(files: dict[str, bytes]) -> int:
    tracemalloc.start()
    try:
        for name, data in files.items():
            require_reason("MALFORMED_BODY", data, MEDIA_TYPES[name.rpartition(".")[2]])
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_counts_that_the_body_cannot_hold_cost_no_memory():
    # The parsers are warm before memory is measured: a first import is not an allocation for the body.
    decode_cloud(pcd_bytes(compressed_body(records()), "binary_compressed", 120), PCD)
    files = {name: body() for name, body in counts().items()}
    # Threads that other tests have left allocate, too: a body would each time.
    if min(_most_traced_bytes(files) for _ in range(3)) >= 2**20:
        pytest.fail("a count alone took memory")
    assert len(files) >= 7 * (len(COUNTS) + 3)


def test_a_bomb_is_stopped_while_it_unpacks():
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(400 * 2**20))
    tracemalloc.start()
    try:
        require_reason("TOO_LARGE", bomb, KITTI, content_encoding="zstd")
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


def test_too_many_points_are_too_large():  # G15
    for media_type, data in valid_files(records()).values():
        with pytest.raises(TooLarge):
            decode_cloud(data, media_type, limits=CloudLimits(max_points=119))
        assert len(decode_cloud(data, media_type, limits=CloudLimits(max_points=120)).points) == 120


def test_the_body_limit_is_exact():
    limits = CloudLimits(max_body_bytes=1600)
    assert len(decode_cloud(bytes(1600), KITTI, limits=limits).points) == 100
    with pytest.raises(TooLarge):
        decode_cloud(bytes(1616), KITTI, limits=limits)


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_a_compressed_body_that_is_whole_is_read_and_another_or_none_is_malformed(encoding):  # G52
    assert len(decode_cloud(data_of(f"G52-whole.{encoding}"), KITTI, content_encoding=encoding).points) == 120
    for damaged in (b"no such thing", b""):
        require_reason("MALFORMED_BODY", damaged, KITTI, content_encoding=encoding)


def test_content_encodings_in_a_row_are_unsupported():  # G54
    require_reason("UNSUPPORTED_ENCODING", bytes(64), KITTI, content_encoding="gzip,zstd")


@pytest.mark.parametrize("media_type", [*formats.MEDIA_TYPES, "application/zip"])
def test_bodies_of_other_kinds_are_unsupported_under_every_media_type(media_type):  # G48 to G50, G55, G56, G58
    others = [
        name for name in bodies() if name.startswith(("G48", "G49", "G50", "G55", "G56", "G58", "G52-whole.gzip"))
    ]
    assert len(others) >= 10
    for name in others:
        if name != "G55-model.onnx":  # has no magic
            require_reason("UNSUPPORTED_ENCODING", data_of(name), media_type)


def test_the_magic_of_one_format_under_the_type_of_another_is_unsupported():  # G57
    for kind, (own, data) in valid_files(records()).items():
        named = b"# .PCD v0.7\n" + data if own == PCD else data
        for media_type in set(formats.MEDIA_TYPES) - {own} if kind != "kitti" else ():
            require_reason("UNSUPPORTED_ENCODING", named, media_type)


@pytest.mark.parametrize("name", ["", "application/octet-stream", "text/plain", "multipart/form-data"])
def test_unknown_media_types_are_unsupported(name):
    require_reason("UNSUPPORTED_ENCODING", bytes(64), name)
