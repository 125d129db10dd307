"""Blobs as objects of a bucket: prefix/tenant/kind/ab/abcdef..., each stored by one request, checked when read.

A body is stored wholly or not at all, and an answer that was lost is asked for again: the same name has the same
content, so that a request may be repeated at will and rests on no condition. No upload in parts is ever begun, so that
none can be left unfinished.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import structlog
from obstore.store import S3Store

from revisit.service.domain.errors import StorageFull, StorageUncertain
from revisit.service.domain.identity import TenantId
from revisit.service.engines.s3.failures import (
    FAILURES,
    UNREACHABLE,
    is_answer,
    is_missing,
    is_mistake,
    reason_of,
    translated,
    whole,
)
from revisit.service.engines.s3.recent_blobs import RecentBlobs
from revisit.service.engines.stored_blobs import (
    QUARANTINE,
    BlobDamaged,
    BlobStoreUnusable,
    blob_at,
    key_of,
    missing,
    quarantined_name,
    require_whole,
)
from revisit.service.ports.blobs import StoredBlob

if TYPE_CHECKING:
    from obstore import ObjectMeta

REQUEST_S = 8.0
"""Longest time of one request; 64 MiB take it at 8 MiB/s. With `RETRIES_S` less than the 15 s of an end by SIGTERM."""

RETRIES_S = 5.0
"""Time from the first request of a call on, after which a failed one is not sent again: whoever called repeats it."""

FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 1.0
ASK_AGAIN_S = 1.0
"""Time between two looks whether a server that has failed answers again."""

PAGE = 1000
"""Objects of one answer to a listing, the most that S3 gives."""

TRIAL = ".trial"
"""The folder of objects that are stored to see whether the bucket takes them."""

ENDPOINTS = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")

log = structlog.get_logger(__name__)


class S3BlobStore:
    """`BlobStore` in a bucket; `BlobOutage` of its server."""

    def __init__(self, url: str, *, request_s: float = REQUEST_S, retries_s: float = RETRIES_S) -> None:
        """`url` is s3://bucket/prefix; access key, region and endpoint are the usual AWS_* variables."""
        self.url = url
        self._store = opened(url, request_s, retries_s)
        self._outage = _Outage(url)
        self._recent = RecentBlobs()

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """See `BlobStore`. A blob that is there already is stored once more, which also mends a damaged one."""
        blob = StoredBlob(tenant, kind, hashlib.sha256(data).hexdigest())
        with self._asked():
            self._store.put(key_of(blob), data, use_multipart=False)
        return blob.sha256

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """See `BlobStore`. Raises also StorageUncertain."""
        blob = StoredBlob(tenant, kind, sha256)
        data = self._recent.get(key_of(blob))
        if data is None:
            data = self._read_twice(blob)
            self._recent.keep(key_of(blob), data)
        return data

    def read(self, blob: StoredBlob) -> bytes:
        """The bytes of a blob; a damaged one is left alone. Raises DataLoss, StorageUncertain."""
        key = key_of(blob)
        with self._asked():
            try:
                data = self._store.get(key).bytes().to_bytes()
            except FileNotFoundError as error:
                if is_missing(error):
                    raise missing(blob) from error
                raise
        return require_whole(blob, data)

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """See `BlobStore`. Raises StorageUncertain."""
        return self._size(tenant, kind, sha256) is not None

    def disk_bytes(self, tenant: TenantId, kind: str, sha256: str) -> int:
        """See `BlobStore`: the size of the object. Raises StorageUncertain."""
        return self._size(tenant, kind, sha256) or 0

    def _size(self, tenant: TenantId, kind: str, sha256: str) -> int | None:
        key = key_of(StoredBlob(tenant, kind, sha256))
        with self._asked():
            try:
                return int(self._store.head(key)["size"])
            except FileNotFoundError:
                return None

    def delete(self, blobs: Collection[StoredBlob]) -> None:
        """See `BlobStore`: one request for up to 1,000."""
        keys = [key_of(blob) for blob in blobs]
        self._recent.drop(keys)
        with self._asked():
            try:
                whole(lambda: self._store.delete(keys))
            except FileNotFoundError as error:
                if not is_missing(error):
                    raise

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """See `BlobStore`: page by page. By the server's time, which differs by at most 15 minutes from this machine's.

        Raises StorageUncertain.
        """
        latest = datetime.now(UTC) - timedelta(seconds=older_than_s)
        for key, changed_at in self._listed():
            blob = blob_at(key)
            if blob is not None and changed_at <= latest:
                yield blob

    def quarantined(self) -> int:
        """How many damaged blobs are in quarantine. Raises StorageUncertain."""
        return sum(1 for _ in self._listed(f"{QUARANTINE}/"))

    def unreachable(self) -> str:
        """See `BlobOutage`: whether the bucket takes an object."""
        if self._outage.is_to_be_asked():
            threading.Thread(target=self._ask_again, name="asks-the-blob-store", daemon=True).start()
        return self._outage.reason

    def _read_twice(self, blob: StoredBlob) -> bytes:
        """The bytes; wrong ones are asked for once more. A damaged blob goes into quarantine."""
        try:
            return self.read(blob)
        except BlobDamaged:
            pass
        try:
            return self.read(blob)
        except BlobDamaged:
            self._quarantine(blob)
            raise

    def _ask_again(self) -> None:
        try:
            with suppress(StorageFull, StorageUncertain), self._noted():
                self._store.put(f"{TRIAL}/again", bytes(4096), use_multipart=False)
        finally:
            self._outage.was_asked()

    def try_out(self) -> bool:
        """Store, read, list and delete an object; whether the bucket keeps versions of what is deleted.

        Raises BlobStoreUnusable.
        """
        key, data = f"{TRIAL}/{secrets.token_hex(8)}", secrets.token_bytes(64)
        try:
            version = self._store.put(key, data, use_multipart=False)["version"]
            same = self._store.get(key).bytes().to_bytes() == data
            listed = key in {found["path"] for found in self._page(f"{TRIAL}/", None)}
            whole(lambda: self._store.delete(key))
        except FAILURES as error:
            raise BlobStoreUnusable(self.url, reason_of(error), for_good=is_mistake(error)) from error
        if not (same and listed):
            raise BlobStoreUnusable(self.url, "it does not give back what it has just stored", for_good=True)
        return version not in (None, "null")

    def _listed(self, prefix: str | None = None) -> Iterator[tuple[str, datetime]]:
        """Keys with the time of their last change."""
        after: str | None = None
        while True:
            with self._asked():
                page = self._page(prefix, after)
            for found in page:
                yield found["path"], found["last_modified"]
            if len(page) < PAGE:
                return
            after = page[-1]["path"]

    def _page(self, prefix: str | None, after: str | None) -> Sequence[ObjectMeta]:
        """At most `PAGE` objects whose keys come after one."""
        return whole(lambda: next(iter(self._store.list(prefix, offset=after, chunk_size=PAGE)), ()))

    def _quarantine(self, blob: StoredBlob) -> None:
        """Keep a copy of a damaged blob, which stays until its content is stored again or its last row goes."""
        log.error("blob_damaged", tenant=blob.tenant, kind=blob.kind, sha256=blob.sha256)
        try:
            self._store.copy(key_of(blob), f"{QUARANTINE}/{quarantined_name(blob)}")
        except FAILURES as error:
            log.warning("blob_not_quarantined", sha256=blob.sha256, reason=reason_of(error))

    @contextmanager
    def _asked(self) -> Iterator[None]:
        """A call of the server. Raises StorageFull, StorageUncertain: at once where it has been silent until now, since
        callers that wait would hold all threads of the process.
        """
        if self._outage.silent and self.unreachable():
            raise StorageUncertain(UNREACHABLE)
        with self._noted():
            yield

    @contextmanager
    def _noted(self) -> Iterator[None]:
        """Raises StorageFull, StorageUncertain."""
        try:
            yield
        except FAILURES as error:
            self._outage.begins(reason_of(error), silent=not is_answer(error))
            raise translated(error) from error
        self._outage.ends()


class _Outage:
    """Whether the last call of a server failed, and why; `silent`: it did not answer, or not now."""

    def __init__(self, url: str) -> None:
        self.reason = ""
        self.silent = False
        self._url = url
        self._lock = threading.Lock()
        self._asking = False
        self._failed_s = 0.0

    def begins(self, reason: str, *, silent: bool) -> None:
        with self._lock:
            first, self.reason, self._failed_s = not self.reason, reason, time.monotonic()
            self.silent = silent
        if first:
            log.error("blob_store_failed", store=self._url, reason=reason)

    def ends(self) -> None:
        if not self.reason:
            return
        with self._lock:
            last, self.reason, self.silent = bool(self.reason), "", False
        if last:
            log.info("blob_store_answers_again", store=self._url)

    def is_to_be_asked(self) -> bool:
        """Whether it failed a while ago and nobody asks; from then on the caller does, until `was_asked`."""
        with self._lock:
            due = bool(self.reason) and not self._asking and time.monotonic() - self._failed_s >= ASK_AGAIN_S
            self._asking = self._asking or due
        return due

    def was_asked(self) -> None:
        self._asking = False


def opened(url: str, request_s: float, retries_s: float) -> S3Store:
    """The bucket of s3://bucket/prefix. Nothing is sent yet."""
    address = urlsplit(url)
    endpoint = next((os.environ[name] for name in ENDPOINTS if os.environ.get(name)), "")
    return S3Store(
        address.netloc,
        prefix=address.path.strip("/") or None,
        # Plain HTTP only where the endpoint says so.
        client_options={
            "allow_http": endpoint.startswith("http://"),
            "timeout": timedelta(seconds=request_s),
            "connect_timeout": timedelta(seconds=min(3.0, request_s)),
        },
        retry_config={
            "max_retries": 100,
            "retry_timeout": timedelta(seconds=retries_s),
            "backoff": {
                "init_backoff": timedelta(seconds=FIRST_PAUSE_S),
                "max_backoff": timedelta(seconds=LONGEST_PAUSE_S),
                "base": 2,
            },
        },
    )
