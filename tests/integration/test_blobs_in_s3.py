"""Blobs in a bucket: what an S3 server does wrong, what somebody has set wrong, and what each means for the service."""

from __future__ import annotations

import ssl
from functools import partial
from itertools import islice

import pytest
import trustme

from revisit.core.errors import DataLoss, ErrorCode
from revisit.service.domain.errors import StorageFull, StorageUncertain
from revisit.service.domain.identity import TenantId
from revisit.service.engines.s3.blobs import PAGE, S3BlobStore
from revisit.service.engines.stored_blobs import BlobStoreUnusable
from revisit.service.ports.blobs import StoredBlob
from tests.support.patience import eventually
from tests.support.s3 import moto, nanio, variables
from tests.support.s3_link import SLOW_DOWN, WHOLE, Fault, at_first, s3_link

TENANT = TenantId("default")
POINTS = b"points" * 10_000

PASSING = {
    "slow down": SLOW_DOWN,
    "internal error": Fault(refused=(500, "InternalError")),
    "too many requests": Fault(refused=(429, "TooManyRequests")),
    "answer lost": Fault(answer_lost=True),
    "body cut": Fault(body_cut=1_000),
    "answer cut": Fault(body_cut=10),
    "silent": Fault(silent=True),
}
OPERATIONS = {
    "put": lambda blobs, name: blobs.put(TENANT, "cloud", POINTS),
    "get": lambda blobs, name: blobs.get(TENANT, "cloud", name),
    "exists": lambda blobs, name: blobs.exists(TENANT, "cloud", name),
    "delete": lambda blobs, name: blobs.delete([StoredBlob(TENANT, "cloud", name)]),
    "stored": lambda blobs, name: list(blobs.stored(0.0)),
}


def use(monkeypatch, address, **other) -> None:
    for name, value in variables(address, **other).items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def bucket(monkeypatch) -> str:
    """The address of a new bucket of nanio."""
    use(monkeypatch, nanio().address)
    return f"s3://{nanio().new_bucket()}/fleet"


@pytest.fixture
def link(bucket, monkeypatch):
    """A link to the server of `bucket`, which clients of the environment take."""
    with s3_link(nanio().address) as link:
        use(monkeypatch, link.url)
        yield link


@pytest.mark.parametrize("fault", PASSING.values(), ids=PASSING)
def test_a_fault_that_passes_is_survived_within_the_call(bucket, link, fault):
    blobs = S3BlobStore(bucket, request_s=0.3)
    link.fault = at_first(fault)
    name = blobs.put(TENANT, "cloud", POINTS)
    assert blobs.get(TENANT, "cloud", name) == POINTS
    assert blobs.exists(TENANT, "cloud", name)
    assert [one.sha256 for one in blobs.stored(0.0)] == [name]
    assert link.count("PUT") >= 1 and link.count("GET") >= 3
    assert blobs.unreachable() == ""


@pytest.mark.parametrize("fault", [SLOW_DOWN, Fault(answer_lost=True), Fault(body_cut=10)], ids=["503", "lost", "cut"])
def test_a_deletion_whose_answer_is_lost_is_sent_again(bucket, link, fault):
    blobs = S3BlobStore(bucket)
    name = blobs.put(TENANT, "cloud", POINTS)
    link.fault = at_first(fault)
    blobs.delete([StoredBlob(TENANT, "cloud", name)])
    assert list(blobs.stored(0.0)) == []
    assert link.count("POST") == 2


def test_a_deletion_that_gets_no_answer_is_sent_once_so_that_none_comes_late(bucket, link):
    blobs = S3BlobStore(bucket, request_s=0.2)
    name = blobs.put(TENANT, "cloud", POINTS)
    link.fault = at_first(Fault(silent=True))
    with pytest.raises(StorageUncertain):
        blobs.delete([StoredBlob(TENANT, "cloud", name)])
    assert link.count("POST") == 1


def test_a_blob_whose_answer_was_lost_is_stored_and_sent_again(bucket, link):
    blobs = S3BlobStore(bucket, retries_s=0.0)
    link.fault = at_first(Fault(answer_lost=True))
    with pytest.raises(StorageUncertain):
        blobs.put(TENANT, "cloud", POINTS)
    link.fault = at_first(WHOLE)
    eventually(lambda: not blobs.unreachable(), "the server is not asked again")
    (stored,) = blobs.stored(0.0)
    assert blobs.put(TENANT, "cloud", POINTS) == stored.sha256
    assert len(list(blobs.stored(0.0))) == 1


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
@pytest.mark.parametrize("fault", [SLOW_DOWN, Fault(answer_lost=True), Fault(silent=True)], ids=["503", "cut", "late"])
def test_a_server_that_does_not_answer_leaves_it_open_and_says_nothing_about_the_blob(bucket, link, fault, operation):
    name = S3BlobStore(bucket).put(TENANT, "cloud", POINTS)
    blobs = S3BlobStore(bucket, request_s=0.2, retries_s=0.2)
    link.fault = at_first(fault, times=1_000)
    with pytest.raises(StorageUncertain):
        operation(blobs, name)
    assert blobs.unreachable() != ""


def test_a_server_that_answers_again_is_found_out_by_asking(bucket, link):
    blobs = S3BlobStore(bucket, retries_s=0.0)
    link.fault = at_first(SLOW_DOWN, times=1_000)
    with pytest.raises(StorageUncertain):
        blobs.put(TENANT, "cloud", POINTS)
    asked = len(link.seen)
    assert "SlowDown" in blobs.unreachable() and len(link.seen) == asked
    link.fault = at_first(SLOW_DOWN, times=0)
    eventually(lambda: not blobs.unreachable(), "the server is not asked again")
    assert blobs.put(TENANT, "cloud", POINTS)


def test_while_a_server_is_silent_calls_end_at_once_and_ask_it_nothing(bucket, link):
    blobs = S3BlobStore(bucket, retries_s=0.0)
    name = blobs.put(TENANT, "cloud", POINTS)
    link.fault = at_first(Fault(answer_lost=True), times=1_000)
    with pytest.raises(StorageUncertain):
        blobs.get(TENANT, "cloud", name)
    asked = len(link.seen)
    for operation in OPERATIONS.values():
        with pytest.raises(StorageUncertain):
            operation(blobs, name)
    assert len(link.seen) == asked
    link.fault = at_first(WHOLE)
    eventually(lambda: not blobs.unreachable(), "the server is not asked again")
    assert blobs.get(TENANT, "cloud", name) == POINTS


def test_a_call_that_is_refused_for_a_missing_right_stops_no_other_call(bucket, link):
    blobs = S3BlobStore(bucket)
    link.fault = lambda request: Fault(refused=(403, "AccessDenied") if request.method == "POST" else None)
    name = blobs.put(TENANT, "cloud", POINTS)
    with pytest.raises(StorageUncertain):
        blobs.delete([StoredBlob(TENANT, "cloud", name)])
    assert blobs.get(TENANT, "cloud", name) == POINTS


@pytest.mark.parametrize("refusal", [(507, "XMinioStorageFull"), (403, "QuotaExceeded"), (507, "Other")])
def test_a_bucket_without_room_is_a_full_store(bucket, link, refusal):
    link.fault = at_first(Fault(refused=refusal), times=1_000)
    with pytest.raises(StorageFull):
        S3BlobStore(bucket, retries_s=0.0).put(TENANT, "cloud", POINTS)


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=OPERATIONS)
def test_a_wrong_secret_is_a_mistake_of_the_operator_and_no_damage(bucket, monkeypatch, operation):
    name = S3BlobStore(bucket).put(TENANT, "cloud", POINTS)
    use(monkeypatch, nanio().address, secret="wrong")
    blobs = S3BlobStore(bucket)
    with pytest.raises(StorageUncertain) as refused:
        operation(blobs, name)
    assert "AWS_SECRET_ACCESS_KEY" in blobs.unreachable()
    assert "bucket" not in refused.value.message and "AWS" not in refused.value.message


@pytest.mark.parametrize("operation", [OPERATIONS["put"], OPERATIONS["get"], OPERATIONS["stored"]])
@pytest.mark.parametrize("server", [moto, nanio])
def test_a_bucket_that_is_gone_is_no_missing_blob(monkeypatch, server, operation):
    use(monkeypatch, server().address)
    blobs = S3BlobStore("s3://nowhere/fleet")
    with pytest.raises(StorageUncertain):
        operation(blobs, "0" * 64)
    assert blobs.unreachable() == "there is no such bucket"


def test_bytes_that_a_link_has_changed_are_asked_for_again(bucket, link):
    blobs = S3BlobStore(bucket)
    name = blobs.put(TENANT, "cloud", POINTS)
    link.fault = at_first(Fault(body_changed=True))
    assert blobs.get(TENANT, "cloud", name) == POINTS
    link.fault = at_first(WHOLE)
    assert blobs.quarantined() == 0


def test_a_damaged_blob_is_refused_kept_aside_and_mended_by_its_content(bucket, monkeypatch):
    blobs = S3BlobStore(bucket)
    name = blobs.put(TENANT, "cloud", POINTS)
    (path,) = (nanio().folder / bucket.removeprefix("s3://")).rglob(name)
    path.write_bytes(POINTS[:-1] + b"S")
    for _ in range(2):
        with pytest.raises(DataLoss, match="damaged"):
            blobs.get(TENANT, "cloud", name)
    assert blobs.quarantined() == 1
    assert blobs.put(TENANT, "cloud", POINTS) == name
    assert blobs.get(TENANT, "cloud", name) == POINTS
    assert [one.sha256 for one in blobs.stored(0.0)] == [name]


def test_a_blob_that_was_read_is_not_asked_for_again_until_it_is_deleted(bucket, link):
    blobs = S3BlobStore(bucket)
    name = blobs.put(TENANT, "signature", b"a place")
    assert [blobs.get(TENANT, "signature", name) for _ in range(3)] == [b"a place"] * 3
    assert link.count("GET") == 1
    blobs.delete([StoredBlob(TENANT, "signature", name)])
    with pytest.raises(DataLoss, match="missing"):
        blobs.get(TENANT, "signature", name)


def test_many_blobs_are_deleted_by_one_request(bucket, link):
    blobs = S3BlobStore(bucket)
    stored = [StoredBlob(TENANT, "cloud", blobs.put(TENANT, "cloud", bytes([number]))) for number in range(20)]
    link.seen.clear()
    blobs.delete(stored)
    assert len(link.seen) == 1
    assert list(blobs.stored(0.0)) == []


def test_no_address_leaves_the_prefix(bucket):
    blobs = S3BlobStore(bucket)
    for address in (("..", "cloud", "ab"), ("default", "../x", "ab"), ("default", "cloud", "../../x")):
        with pytest.raises(DataLoss, match="address"):
            blobs.get(*address)


def test_a_sweep_reads_a_page_of_names_at_a_time(bucket, link):
    folder = nanio().folder / bucket.removeprefix("s3://") / TENANT / "cloud" / "ab"
    folder.mkdir(parents=True)
    for number in range(PAGE + 1):
        (folder / f"ab{number:062x}").touch()
    found = S3BlobStore(bucket).stored(0.0)
    assert len(list(islice(found, PAGE // 2))) == PAGE // 2
    assert link.count("GET") == 1
    assert len(list(found)) == PAGE + 1 - PAGE // 2
    assert link.count("GET") == 2


def test_young_blobs_are_left_out_of_a_sweep(bucket):
    blobs = S3BlobStore(bucket)
    blobs.put(TENANT, "cloud", POINTS)
    assert list(blobs.stored(60.0)) == []


MISTAKES = {
    "another bucket": (lambda bucket: "s3://nowhere", {}, "there is no such bucket", True),
    "another secret": (lambda bucket: bucket, {"secret": "wrong"}, "AWS_SECRET_ACCESS_KEY", True),
    "another address": (lambda bucket: bucket, {"address": "127.0.0.1:9"}, "no answer", False),
}


@pytest.mark.parametrize(("place", "other", "words", "for_good"), MISTAKES.values(), ids=MISTAKES)
def test_a_trial_says_what_is_wrong(bucket, monkeypatch, place, other, words, for_good):
    use(monkeypatch, other.pop("address", nanio().address), **other)
    with pytest.raises(BlobStoreUnusable, match=words) as unusable:
        S3BlobStore(place(bucket), retries_s=0.2).try_out()
    assert unusable.value.for_good == for_good
    assert str(unusable.value).startswith("s3://")


def test_a_private_authority_is_trusted_where_a_variable_names_it(bucket, monkeypatch, tmp_path):
    authority, context = trustme.CA(), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("localhost").configure_cert(context)
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    with s3_link(nanio().address, tls=context) as link:
        use(monkeypatch, link.url)
        with pytest.raises(BlobStoreUnusable, match="SSL_CERT_FILE") as unusable:
            S3BlobStore(bucket, retries_s=0.0).try_out()
        assert unusable.value.for_good
        monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
        assert S3BlobStore(bucket).try_out() is False


@pytest.mark.parametrize("right", ["PUT", "GET", "POST"])
def test_a_trial_needs_the_rights_to_write_read_and_delete(bucket, link, right):
    link.fault = lambda request: Fault(refused=(403, "AccessDenied") if request.method == right else None)
    with pytest.raises(BlobStoreUnusable, match=r"s3:PutObject"):
        S3BlobStore(bucket).try_out()


def test_a_trial_leaves_nothing_and_tells_a_bucket_that_keeps_versions(bucket, monkeypatch):
    assert S3BlobStore(bucket).try_out() is False
    assert not any(path.is_file() for path in (nanio().folder / bucket.removeprefix("s3://")).rglob("*/*"))
    use(monkeypatch, moto().address)
    new_bucket = partial(moto().new_bucket, versions=True)
    assert S3BlobStore(f"s3://{new_bucket()}").try_out() is True


def test_the_errors_are_those_that_clients_repeat():
    assert {StorageUncertain.code, StorageFull.code} == {ErrorCode.STORAGE_UNCERTAIN, ErrorCode.STORAGE_FULL}
