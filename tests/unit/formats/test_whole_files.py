"""A file has its name once it is whole."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from revisit.formats.whole_files import write_whole, written_beside


def test_a_file_that_is_cut_off_leaves_the_former_one(tmp_path):
    out = tmp_path / "map.ply"
    write_whole(out, "whole")
    with pytest.raises(RuntimeError):
        cut_off(out)
    assert (out.read_text(), list(tmp_path.iterdir())) == ("whole", [out])


def cut_off(out):
    with written_beside(out) as part:
        part.write_bytes(b"ha")
        assert out.read_text() == "whole"
        raise RuntimeError


def test_two_that_write_one_name_leave_the_whole_file_of_one(tmp_path):
    out = tmp_path / "map.ply"
    with written_beside(out) as first, first.open("wb") as stream:
        stream.write(b"fi")
        write_whole(out, b"second")
        stream.write(b"rst")
    assert (out.read_bytes(), list(tmp_path.iterdir())) == (b"first", [out])


def test_a_file_of_another_name_is_left_alone(tmp_path):
    mine = tmp_path / "map.ply.part"
    mine.write_bytes(b"mine")
    write_whole(tmp_path / "map.ply", b"x")
    assert mine.read_bytes() == b"mine"


def test_a_name_of_any_length_is_written(tmp_path):
    out = tmp_path / ("n" * 255)
    write_whole(out, b"x")
    assert out.read_bytes() == b"x"


def test_a_file_keeps_its_permissions(tmp_path):
    out = tmp_path / "map.ply"
    out.touch(mode=0o600)
    write_whole(out, b"x")
    assert out.stat().st_mode & 0o777 == 0o600


def test_an_error_names_the_file_that_was_asked_for(tmp_path):
    out = tmp_path / "gone" / "map.ply"
    with pytest.raises(FileNotFoundError) as refused:
        write_whole(out, b"x")
    assert refused.value.filename == str(out)


def test_what_is_printed_behind_an_export_to_stdout_follows_it(tmp_path):
    code = "from pathlib import Path; from revisit.formats.whole_files import write_whole as w"
    code += "; w(Path('/dev/stdout'), 'x'); print('y')"
    with (tmp_path / "out").open("ab") as stream:
        subprocess.run([sys.executable, "-c", code], stdout=stream, check=True)
    assert (tmp_path / "out").read_text() == "xy\n"


def test_a_link_stays_one(tmp_path):
    (tmp_path / "to").mkdir()
    out = tmp_path / "link"
    out.symlink_to(tmp_path / "to/map.ply")
    write_whole(out, b"x")
    assert out.is_symlink() and (tmp_path / "to/map.ply").read_bytes() == b"x"


def test_a_pipe_is_written_to(tmp_path):
    out, read = tmp_path / "pipe", []
    os.mkfifo(out)
    reader = threading.Thread(target=lambda: read.append(out.read_bytes()))
    reader.start()
    write_whole(out, b"x")
    reader.join()
    assert read == [b"x"] and out.is_fifo()
