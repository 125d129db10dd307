"""Files written by hand: see `tests.support.cloud_files`."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.support import cloud_files

KINDS = list(cloud_files.valid_files(cloud_files.records(2)))


@pytest.fixture(params=KINDS)
def valid_file(request: pytest.FixtureRequest) -> tuple[str, bytes]:
    return cloud_files.valid_files(cloud_files.records())[request.param]


@pytest.fixture(scope="session")
def make():
    """The writers, for tests that need a file with a fault."""
    return SimpleNamespace(
        pcd=cloud_files.pcd_bytes,
        ply=cloud_files.ply_bytes,
        npy=cloud_files.npy_bytes,
        records=cloud_files.records,
        ascii=cloud_files.ascii_body,
        compressed=cloud_files.compressed_body,
        valid=cloud_files.valid_files,
        lzf=cloud_files.lzf_compress,
    )
