"""Failures of an S3 server: what each means for the service, in the words of its operator."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

from obstore.exceptions import BaseError

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import StorageFull, StorageUncertain

T = TypeVar("T")

TRIES = 3

NO_ROOM = frozenset({"507", "QuotaExceeded", "XMinioAdminBucketQuotaExceeded", "XMinioStorageFull"})
"""Codes of servers without room, MinIO's and Ceph's, and the status of HTTP."""

RIGHTS = "s3:GetObject, s3:PutObject and s3:DeleteObject on the objects and s3:ListBucket on the bucket"

REASONS = {
    "AccessDenied": f"the access key may not do this; it needs {RIGHTS}",
    "AllAccessDisabled": "the bucket is closed",
    "AuthorizationHeaderMalformed": "the bucket is in another region (AWS_REGION)",
    "ExpiredToken": "the session of the access key has ended (AWS_SESSION_TOKEN)",
    "InvalidAccessKeyId": "the access key is unknown there (AWS_ACCESS_KEY_ID)",
    "InvalidCertificate": "its certificate is not to be trusted (SSL_CERT_FILE names the file of a private authority)",
    "InvalidToken": "the session of the access key is none (AWS_SESSION_TOKEN)",
    "NoSuchBucket": "there is no such bucket",
    "PermanentRedirect": "the bucket is in another region (AWS_REGION)",
    "SignatureDoesNotMatch": "the secret is not that of the access key (AWS_SECRET_ACCESS_KEY)",
    # An answer without a body has no code.
    "403": f"access is refused: AWS_ACCESS_KEY_ID or AWS_SECRET_ACCESS_KEY is wrong, or the key lacks {RIGHTS}",
}
"""Mistakes that somebody must mend; other failures may pass by themselves."""

UNREACHABLE = "the store of blobs does not answer as it should; repeat this with the same id"
"""For clients."""

FAILURES = (BaseError, OSError)
"""Errors of a call of obstore; a missing object is a FileNotFoundError."""

_CODE = re.compile(r"<Code>(\w+)</Code>|\(code: (\w+)\)")
_STATUS = re.compile(r"status code: (\d{3})")


def codes_of(error: BaseException) -> list[str]:
    """The server's own code, where it gave one, its HTTP status, that of its handshake; none without answer."""
    text = str(error)
    own = [code or other for code, other in _CODE.findall(text)[:1]]
    return own + _STATUS.findall(text)[:1] + [code for code in ("InvalidCertificate",) if code in text]


def is_missing(error: BaseException) -> bool:
    """Whether the object is not there, in a bucket that is."""
    return isinstance(error, FileNotFoundError) and "NoSuchBucket" not in codes_of(error)


def is_mistake(error: BaseException) -> bool:
    """Whether somebody must mend a setting or a right."""
    return any(code in REASONS for code in codes_of(error))


def is_answer(error: BaseException) -> bool:
    """Whether the server has refused this very call; else it is silent, or too busy to answer anybody."""
    if "InvalidCertificate" in codes_of(error):
        return False
    return is_mistake(error) or bool(NO_ROOM.intersection(codes_of(error))) or isinstance(error, FileNotFoundError)


def whole(call: Callable[[], T]) -> T:
    """The result of a call that may be repeated: obstore asks again for everything but an answer that breaks off."""
    for _ in range(TRIES - 1):
        try:
            return call()
        except FAILURES as error:
            if "response body" not in str(error):
                raise
    return call()


def reason_of(error: BaseException) -> str:
    """One line for the operator."""
    codes = codes_of(error)
    known = next((REASONS[code] for code in codes if code in REASONS), "")
    first = str(error).partition("\n")[0]
    return known or (f"it answered {codes[0]}" if codes else f"no answer: {first[:200]}")


def translated(error: BaseException) -> RevisitError:
    """The error of the service: StorageFull, else StorageUncertain. Its message is for clients and names no bucket."""
    if NO_ROOM.intersection(codes_of(error)):
        return StorageFull("the store of blobs has no room: nothing was stored")
    return StorageUncertain(UNREACHABLE)
