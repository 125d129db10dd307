"""A version of a map in one file: the same bytes for the same version, checked, read piecewise, compared."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import DataLoss, MalformedBody
from revisit.core.geometry import se3
from revisit.formats.map_file import FiledSubmap, MapDescription, MapFile, difference, hash_of_file, write_map_file

DESCRIPTION = MapDescription(
    map_id="yard", map_version="3", content_hash="c0ffee", created_at_ns=7, model_version="m-1", scene_scale=1.0,
    tau_m=10.0, stride_m=5.0, loop_policy={"candidates": 20, "min_score": None},
)  # fmt: skip


def a_submap(number, x=0.0, frame="frame-1"):
    neural = f"neural map {number}".encode() * 500
    filed = FiledSubmap(
        f"maps/yard/sessions/monday/submaps/{number}", number, 1_700_000_000_000_000_000 + number, frame,
        se3.from_yaw(0.1 * number, (x, 2.0, 3.0)), np.eye(4), hashlib.sha256(neural).hexdigest(),
    )  # fmt: skip
    return filed, np.full(4, number, dtype=np.float32), neural


def written(file: Path, submaps, description=DESCRIPTION):
    write_map_file(file, description, submaps)
    return MapFile.open(file)


def test_a_map_is_read_back_as_it_was_written(tmp_path):
    submaps = [a_submap(n, x=1.5 * n) for n in range(3)]
    with written(tmp_path / "a.zip", submaps) as found:
        assert found.description == DESCRIPTION
        np.testing.assert_array_equal(found.descriptors, [vector for _, vector, _ in submaps])
        for (filed, _, neural), one in zip(submaps, found.submaps, strict=True):
            np.testing.assert_array_equal(one.T_map_submap, filed.T_map_submap)
            assert (one.name, one.stamp_ns, one.session) == (filed.name, filed.stamp_ns, "maps/yard/sessions/monday")
            assert found.neural_map(one) == neural
        found.verify()


def test_the_same_version_has_the_same_bytes_and_any_zip_tool_reads_it(tmp_path):
    submaps = [a_submap(n) for n in range(3)]
    hashes = [write_map_file(tmp_path / name, DESCRIPTION, submaps) for name in ("a.zip", "b.zip")]
    assert hashes[0] == hashes[1] == hash_of_file(tmp_path / "a.zip")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.testzip() is None
        manifest = json.loads(archive.read("manifest.json"))
    assert (manifest["mapId"], manifest["mapVersion"], manifest["submaps"]) == ("yard", "3", 3)


class Counting(io.BytesIO):
    """Counts the bytes that are read."""

    taken = 0

    def read(self, size=-1):
        data = super().read(size)
        self.taken += len(data)
        return data


def test_one_neural_map_is_read_without_the_others(tmp_path):
    submaps = [a_submap(n) for n in range(200)]
    write_map_file(tmp_path / "a.zip", DESCRIPTION, submaps)
    stream = Counting((tmp_path / "a.zip").read_bytes())
    found = MapFile(stream)
    opened, size = stream.taken, len(stream.getvalue())
    assert opened < 0.15 * size
    assert found.neural_map(found.submaps[7]) == submaps[7][2]
    assert stream.taken - opened < 3 * len(submaps[7][2])


@pytest.mark.parametrize("wrong", [b"", b"no zip", b"PK\x05\x06" + bytes(18)])
def test_what_is_no_map_is_refused(wrong):
    with pytest.raises(MalformedBody):
        MapFile(io.BytesIO(wrong))


def forged(file: Path, member: str, old: bytes, new: bytes) -> io.BytesIO:
    """The file with another word in a member of it, and sizes and hashes that fit, as anybody can write one."""
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    data = members[member].replace(old, new)
    assert data != members[member]
    entries = [
        f'"bytes":{len(one)},"sha256":"{hashlib.sha256(one).hexdigest()}"'.encode() for one in (members[member], data)
    ]
    members[member] = data
    members["manifest.json"] = members["manifest.json"].replace(*entries)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as copy:
        for name, content in members.items():
            copy.writestr(name, content)
    return out


@pytest.mark.parametrize(
    "size", [b"Infinity", b"-Infinity", b"NaN", b"1e999", b"null", b"true", b"-1", b'"7"', b"[]", b"7.5"]
)
def test_a_size_that_is_no_whole_number_is_refused_when_the_file_is_opened(tmp_path, size):
    filed, vector, neural = a_submap(0)
    write_map_file(tmp_path / "a.zip", DESCRIPTION, [(filed, vector, neural)])
    known = f'"bytes":{len(neural)},'.encode()
    with pytest.raises(MalformedBody):
        MapFile(forged(tmp_path / "a.zip", "manifest.json", known, b'"bytes":' + size + b","))


@pytest.mark.parametrize("number", [b"Infinity", b"1e999", b"NaN", b"null", b"[]"])
def test_a_submap_whose_place_in_the_drive_is_no_number_is_refused(tmp_path, number):
    write_map_file(tmp_path / "a.zip", DESCRIPTION, [a_submap(0)])
    with pytest.raises(MalformedBody):
        MapFile(forged(tmp_path / "a.zip", "submaps.json", b'"ordinal":0,', b'"ordinal":' + number + b","))


def test_a_flipped_bit_is_found_and_a_cut_file_is_refused(tmp_path):
    write_map_file(tmp_path / "a.zip", DESCRIPTION, [a_submap(n) for n in range(3)])
    whole = (tmp_path / "a.zip").read_bytes()
    damaged = bytearray(whole)
    damaged[whole.index(b"neural map 1neural map 1") + 40] ^= 1
    found = MapFile(io.BytesIO(bytes(damaged)))
    assert found.neural_map(found.submaps[0])
    with pytest.raises(DataLoss):
        found.neural_map(found.submaps[1])
    with pytest.raises(DataLoss):
        found.verify()
    with pytest.raises(MalformedBody):
        MapFile(io.BytesIO(whole[: len(whole) // 2]))


def test_a_neural_map_that_its_submap_does_not_name_is_not_written(tmp_path):
    filed, vector, _ = a_submap(0)
    with pytest.raises(ValueError, match="another neural map"):
        write_map_file(tmp_path / "a.zip", DESCRIPTION, [(filed, vector, b"other")])


def test_two_versions_are_compared(tmp_path):
    older = [a_submap(0), a_submap(1), a_submap(2, frame="frame-9")]
    newer = [a_submap(1, x=0.5), a_submap(2), a_submap(3)]
    with (
        written(tmp_path / "a.zip", older) as before,
        written(tmp_path / "b.zip", newer, replace(DESCRIPTION, map_version="4")) as after,
    ):
        found = difference(before, after)
    names = [filed.name for filed, _, _ in (a_submap(n) for n in range(4))]
    assert (found.added, found.removed, found.other_frame) == ((names[3],), (names[0],), (names[2],))
    assert found.moved_m == pytest.approx({names[1]: 0.5})
    assert found.bytes_known == 2 * len(newer[0][2])
    assert found.bytes_new > len(newer[2][2])
