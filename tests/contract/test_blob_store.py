"""The contract of BlobStore."""

from __future__ import annotations

import hashlib

import pytest

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import StorageUncertain
from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.files import blobs as files
from revisit.service.engines.local.files.blobs import FileBlobStore, blob_path
from revisit.service.engines.s3.blobs import S3BlobStore
from revisit.service.ports.blobs import StoredBlob
from tests.support.memory.blobs import MemoryBlobStore
from tests.support.s3 import moto, nanio, variables

TENANT, OTHER = TenantId("default"), TenantId("other")


@pytest.fixture(params=["memory", "files", "moto", "nanio"])
def blobs(request, tmp_path, monkeypatch):
    if request.param == "memory":
        return MemoryBlobStore()
    if request.param == "files":
        return FileBlobStore(tmp_path / "blobs")
    server = moto() if request.param == "moto" else nanio()
    for name, value in variables(server.address).items():
        monkeypatch.setenv(name, value)
    return S3BlobStore(f"s3://{server.new_bucket()}/fleet/blobs")


def test_a_blob_is_named_by_its_content_and_read_back(blobs):
    name = blobs.put(TENANT, "cloud", b"points")
    assert name == hashlib.sha256(b"points").hexdigest()
    assert blobs.get(TENANT, "cloud", name) == b"points"
    assert blobs.put(TENANT, "cloud", b"points") == name


def test_an_empty_blob_is_a_blob(blobs):
    assert blobs.get(TENANT, "cloud", blobs.put(TENANT, "cloud", b"")) == b""


def test_tenants_and_kinds_do_not_share_blobs(blobs):
    name = blobs.put(TENANT, "cloud", b"points")
    for tenant, kind in ((OTHER, "cloud"), (TENANT, "mesh")):
        assert not blobs.exists(tenant, kind, name)
        with pytest.raises(DataLoss, match="missing"):
            blobs.get(tenant, kind, name)


def test_a_deleted_blob_is_gone_and_deleting_it_again_is_nothing(blobs):
    name = blobs.put(TENANT, "cloud", b"points")
    for _ in range(2):
        blobs.delete([StoredBlob(TENANT, "cloud", name)])
    assert not blobs.exists(TENANT, "cloud", name)


def test_a_blob_says_what_it_takes_and_nothing_takes_nothing(blobs):
    name = blobs.put(TENANT, "cloud", bytes(10_000))
    assert 10_000 <= blobs.disk_bytes(TENANT, "cloud", name) <= 3 * 10_000
    assert blobs.disk_bytes(OTHER, "cloud", name) == 0


def test_all_blobs_of_all_tenants_are_listed_once_they_are_old_enough(blobs):
    kept = {(TENANT, "cloud", blobs.put(TENANT, "cloud", b"points")), (OTHER, "mesh", blobs.put(OTHER, "mesh", b"m"))}
    forgotten = [StoredBlob(OTHER, "mesh", blobs.put(OTHER, "mesh", bytes([number]))) for number in range(3)]
    blobs.delete([*forgotten, forgotten[0]])
    assert {(one.tenant, one.kind, one.sha256) for one in blobs.stored(0.0)} == kept


@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: b"P" + data[1:], lambda data: b""])
def test_a_damaged_file_is_refused(tmp_path, damage):
    blobs = FileBlobStore(tmp_path)
    name = blobs.put(TENANT, "cloud", b"points")
    path = tmp_path / TENANT / "cloud" / name[:2] / name
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DataLoss, match="damaged"):
        blobs.get(TENANT, "cloud", name)


@pytest.mark.parametrize("address", [("..", "cloud", "ab"), ("default", "../x", "ab"), ("default", "cloud", "../../x")])
def test_no_address_leaves_the_directory(tmp_path, address):
    with pytest.raises(DataLoss):
        FileBlobStore(tmp_path / "blobs").get(*address)


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    blobs = FileBlobStore(tmp_path)

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("revisit.service.engines.local.files.disk.os.fsync", full)
    with pytest.raises(Exception) as refused:
        blobs.put(TENANT, "cloud", b"points")
    assert refused.value.code == "STORAGE_FULL"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_folder_goes_with_its_last_blob(tmp_path):
    store = FileBlobStore(tmp_path)
    kept = [StoredBlob(TENANT, "cloud", store.put(TENANT, "cloud", bytes([n]))) for n in range(40)]
    folders = {blob_path(tmp_path, one).parent for one in kept}
    store.delete(kept[1:])
    left = {folder for folder in folders if folder.exists()}
    assert left == {blob_path(tmp_path, kept[0]).parent} and len(folders) > 30
    assert store.get(TENANT, "cloud", kept[0].sha256) == bytes([0])
    assert [one.sha256 for one in store.stored(-1.0)] == [kept[0].sha256]


def test_a_blob_is_kept_whose_folder_went_while_it_was_written(tmp_path, monkeypatch):
    store, made, make_directories = FileBlobStore(tmp_path), [], files.make_directories

    def emptied(path, root):
        make_directories(path, root)
        made.append(path)
        if len(made) < 3:
            path.rmdir()  # by another process, which deletes the last blob in it

    monkeypatch.setattr(files, "make_directories", emptied)
    sha256 = store.put(TENANT, "cloud", b"new")
    assert store.get(TENANT, "cloud", sha256) == b"new" and len(made) == 3
    monkeypatch.setattr(files, "make_directories", lambda path, root: None)
    with pytest.raises(StorageUncertain):
        FileBlobStore(tmp_path / "other").put(TENANT, "cloud", b"never")
