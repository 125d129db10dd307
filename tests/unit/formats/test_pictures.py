"""Kind and size of pictures by their bytes, and files that only look like pictures."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import pytest

from revisit.core.errors import MalformedBody, RevisitError, TooLarge, UnsupportedEncoding
from revisit.formats.pictures import JPEG, PNG, Picture, PictureLimits, read_picture
from tests.support.made_pictures import PNG_BEGIN, a_jpeg, a_png, header, part, segment

ROOT = Path(__file__).resolve().parents[3]
LIMITS = PictureLimits(megapixels=100, side=30_000)
PAGE = b"<!doctype html><script>alert(1)</script>"
PIXELS, END = part(b"IDAT", b"x"), part(b"IEND")


def test_kind_and_size_are_those_of_the_file():
    assert read_picture(a_png(40, 30), LIMITS) == Picture(PNG, 40, 30)
    assert read_picture(a_jpeg(40, 30), LIMITS) == Picture(JPEG, 40, 30)
    assert read_picture(a_jpeg(7, 9, frame=0xC2), LIMITS) == Picture(JPEG, 7, 9)
    restarts = a_jpeg(coded=b"\x01\xff\x00\xff\xd0\x02\xff\xd7\x03")
    assert read_picture(restarts, LIMITS) == Picture(JPEG, 40, 30)


def test_pictures_of_real_programs_are_read():
    files = sorted((ROOT / "docs/images").glob("*.png"))
    assert len(files) > 5
    for file in files:
        assert read_picture(file.read_bytes(), LIMITS).media_type == PNG


@pytest.mark.parametrize("option", [{"quality": 70}, {"progressive": True}, {"restart_marker_rows": 1}])
def test_photographs_of_an_encoder_are_read(tmp_path, option):
    image = pytest.importorskip("PIL.Image")
    file = tmp_path / "photo.jpg"
    image.effect_noise((321, 123), 80).save(file, **option)
    assert read_picture(file.read_bytes(), LIMITS) == Picture(JPEG, 321, 123)


HOSTILE = {
    "nothing": (b"", UnsupportedEncoding),
    "a page": (PAGE, UnsupportedEncoding),
    "a drawing": (b'<svg xmlns="http://www.w3.org/2000/svg" onload="alert(1)"/>', UnsupportedEncoding),
    "a gif": (b"GIF89a" + bytes(20), UnsupportedEncoding),
    "a tiff": (b"II*\x00" + bytes(20), UnsupportedEncoding),
    "a page that begins as a picture": (PNG_BEGIN + PAGE, MalformedBody),
    "a page that begins as a photograph": (b"\xff\xd8\xff\xe0" + PAGE, MalformedBody),
    "a picture with a page behind it": (a_png() + PAGE, MalformedBody),
    "a photograph with an archive behind it": (a_jpeg() + b"PK\x03\x04", MalformedBody),
    "two photographs": (2 * a_jpeg(), MalformedBody),
    "a header alone": (PNG_BEGIN + header(40, 30), MalformedBody),
    "no pixels": (PNG_BEGIN + header(40, 30) + END, MalformedBody),
    "two headers": (PNG_BEGIN + 2 * header(40, 30) + PIXELS + END, MalformedBody),
    "pixels before the header": (PNG_BEGIN + PIXELS + header(40, 30) + END, MalformedBody),
    "no width": (a_png(0, 30), MalformedBody),
    "no height": (a_jpeg(40, 0), MalformedBody),
    "3 bits of colour": (PNG_BEGIN + header(40, 30, depth=3) + PIXELS + END, MalformedBody),
    "colours of type 5": (PNG_BEGIN + header(40, 30, colour=5) + PIXELS + END, MalformedBody),
    "2^31 wide": (PNG_BEGIN + header(2**31 - 1, 1) + PIXELS + END, TooLarge),
    "101 megapixels": (PNG_BEGIN + header(10_100, 10_000) + PIXELS + END, TooLarge),
    "65535 a side": (a_jpeg(65_535, 65_535), TooLarge),
    "a strip": (PNG_BEGIN + header(30_001, 1) + PIXELS + END, TooLarge),
    "a length beyond the file": (PNG_BEGIN + header(40, 30) + b"\xff\xff\xff\xffIDAT", MalformedBody),
    "a part that no reader knows": (a_png(40, 30, part(b"EVIL")), MalformedBody),
    "a part without a name": (a_png(40, 30, part(b"a<b>")), MalformedBody),
    "arithmetic coding": (a_jpeg(frame=0xC9), UnsupportedEncoding),
    "without loss": (a_jpeg(frame=0xC3), UnsupportedEncoding),
    "no frame": (b"\xff\xd8" + segment(0xDA, b"\x01") + b"\x00\xff\xd9", MalformedBody),
    "no scan": (b"\xff\xd8" + segment(0xC0, b"\x08\x00\x09\x00\x09\x01\x01\x11\x00") + b"\xff\xd9", MalformedBody),
    "101 scans": (a_jpeg(coded=b"\x00" + 100 * (segment(0xDA, b"\x01") + b"\x00")), MalformedBody),
    "a segment of length 1": (b"\xff\xd8\xff\xe0\x00\x01\xff\xd9", MalformedBody),
}


@pytest.mark.parametrize(("data", "error"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_that_is_no_plain_picture_is_refused(data, error):
    with pytest.raises(error) as refused:
        read_picture(data, LIMITS)
    assert refused.value.field == "image"


def test_bytes_that_fill_before_a_marker_are_read_over():
    whole = a_jpeg()
    filled = whole.replace(segment(0xE0, b"JFIF\x00"), b"\xff\xff" + segment(0xE0, b"JFIF\x00"))
    assert read_picture(filled, LIMITS) == read_picture(whole, LIMITS)


@pytest.mark.parametrize("whole", [a_png(), a_jpeg()], ids=["png", "jpeg"])
def test_a_file_cut_short_or_damaged_anywhere_is_read_or_refused_and_nothing_else(whole):
    for size in range(len(whole)):
        with pytest.raises(RevisitError):
            read_picture(whole[:size], LIMITS)
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[size] ^= 1 << bit
            with contextlib.suppress(RevisitError):
                read_picture(bytes(damaged), LIMITS)


@pytest.mark.parametrize("whole", [
    a_jpeg(coded=b"\xff\x00" * (7 * 2**20)),
    PNG_BEGIN + header(9, 9) + part(b"tEXt") * 2**20,
    b"\xff\xd8" + b"\xff\x01" * (7 * 2**20),
    b"\xff\xd8" + b"\xff" * (14 * 2**20),
], ids=["stuffed bytes", "empty parts", "empty segments", "filling bytes"])  # fmt: skip
def test_the_worst_file_of_the_largest_size_takes_a_moment(whole):
    began_s = time.thread_time()
    with contextlib.suppress(MalformedBody):
        read_picture(whole, LIMITS)
    assert time.thread_time() - began_s < 0.5
