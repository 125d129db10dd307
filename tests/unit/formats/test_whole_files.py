"""A file has its name once it is whole."""

from __future__ import annotations

import os
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
